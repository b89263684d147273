// Small helpers for the document. No markup is ever made from text that came from a file.

export const $ = (id) => document.getElementById(id);

export function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith('on')) made.addEventListener(key.slice(2), value);
    else if (key in made && key !== 'list' && key !== 'for') made[key] = value;
    else made.setAttribute(key === 'htmlFor' ? 'for' : key, value);
  }
  made.append(...children);
  return made;
}

const SVG = 'http://www.w3.org/2000/svg';
export function svg(name, attributes = {}, ...children) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

export function fillList(list, rows) {
  list.replaceChildren(...rows.flatMap(([term, value]) => [
    element('dt', {}, term), element('dd', {}, ...(Array.isArray(value) ? value : [value]))]));
}

let noticeTimer = 0;
export function notice(text, seconds = 5) {
  $('notice').textContent = text;
  clearTimeout(noticeTimer);
  if (text && seconds) noticeTimer = setTimeout(() => { $('notice').textContent = ''; }, 1000 * seconds);
}

export function download(name, type, content) {
  const link = element('a', { href: URL.createObjectURL(new Blob([content], { type })), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

export function fixed(value, digits = 2) {
  if (!Number.isFinite(value)) return '–';
  const text = value.toFixed(digits);
  return Number(text) === 0 ? text.replace('-', '') : text;
}
export const signed = (value, digits = 2) => (Number.isFinite(value) ? (value >= 0 ? '+' : '−') + Math.abs(value).toFixed(digits) : '–');

// Degrees with their letters, to a tenth of a millimetre or so.
export function degreesText([lon, lat]) {
  const part = (v, letters) => `${Math.abs(v).toFixed(7)}° ${letters[v < 0 ? 1 : 0]}`;
  return Number.isFinite(lon) ? `${part(lat, 'NS')}, ${part(lon, 'EW')}` : '–';
}
