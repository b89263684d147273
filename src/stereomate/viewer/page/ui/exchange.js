// Measurements to files and back: GeoJSON (longitude, latitude), CSV (as `stereomate measure` reads it), KML.

import { KINDS } from './measurements.js';
import { reasonsOf } from '../measure/exact.js';

const round = (v, digits) => (Number.isFinite(v) ? Number(v.toFixed(digits)) : null);

function vertexRecord(product, item, index) {
  const { left, right } = item.vertices[index], point = item.result?.points?.[index];
  const onLeft = product.mapOf(...left), onRight = product.mapOf(...right);
  return {
    easting: round(point?.point?.[0], 4), northing: round(point?.point?.[1], 4), height: round(point?.point?.[2], 4),
    sigma_e: round(point?.sigma?.[0], 4), sigma_n: round(point?.sigma?.[1], 4), sigma_h: round(point?.sigma?.[2], 4),
    sigma_h_orientation: round(point?.orientationSigma?.[2], 4),
    law_height: round(point?.lawHeight, 4), miss_m: round(point?.miss, 4),
    photographs: (point?.photographs ?? []).map((k) => product.photographs[k]?.name ?? ''),
    flags: point ? reasonsOf(point.flags).join('; ') : '',
    left_x: round(onLeft[0], 5), left_y: round(onLeft[1], 5), right_x: round(onRight[0], 5), right_y: round(onRight[1], 5),
  };
}

function resultRecord(item) {
  const r = item.result ?? {};
  const keys = ['height', 'heightSigma', 'lawHeight', 'leaning', 'onMap', 'spatial', 'lengthSigma', 'area', 'areaOnGround',
    'volumeOver', 'volumeUnder'];
  return Object.fromEntries(keys.filter((key) => Number.isFinite(r[key])).map((key) => [key, round(r[key], 4)]));
}

const isKnown = (item) => item.result?.points?.every((p) => p.point && p.degrees);
const position = (p) => [round(p.degrees[0], 9), round(p.degrees[1], 9), round(p.point[2], 4)];

export function toGeoJson(product, items) {
  const features = items.map((item) => {
    const places = isKnown(item) ? item.result.points.map(position) : null;
    let geometry = null;
    if (places) {
      if (item.kind === 'point') geometry = { type: 'Point', coordinates: places[0] };
      else if (item.kind === 'area') geometry = { type: 'Polygon', coordinates: [[...places, places[0]]] };
      else geometry = { type: 'LineString', coordinates: places };
    }
    return {
      type: 'Feature',
      geometry,
      properties: {
        name: item.name, kind: item.kind, ...resultRecord(item), crs: crsText(product),
        vertices: item.vertices.map((_, k) => vertexRecord(product, item, k)),
        stereomate: { product: product.key, kind: item.kind, name: item.name },
      },
    };
  });
  return JSON.stringify({ type: 'FeatureCollection', features }, null, 1);
}

export const crsText = (product) => (product.crs.epsg ? `EPSG:${product.crs.epsg}` : product.crs.name);

const COLUMNS = ['name', 'kind', 'measurement', 'vertex', 'left_x', 'left_y', 'right_x', 'right_y', 'easting', 'northing',
  'height', 'sigma_e', 'sigma_n', 'sigma_h', 'sigma_h_orientation', 'law_height', 'miss_m', 'longitude', 'latitude', 'photographs', 'flags'];

export function toCsv(product, items) {
  const lines = [COLUMNS.join(',')];
  for (const item of items) {
    item.vertices.forEach((_, k) => {
      const degrees = item.result?.points?.[k]?.degrees ?? [null, null];
      const row = {
        name: item.vertices.length > 1 ? `${item.name}.${k + 1}` : item.name,
        kind: item.kind, measurement: item.name, vertex: k + 1, ...vertexRecord(product, item, k),
        longitude: round(degrees[0], 9), latitude: round(degrees[1], 9),
      };
      row.photographs = row.photographs.join(' ');
      lines.push(COLUMNS.map((key) => csvCell(row[key])).join(','));
    });
  }
  return lines.join('\n') + '\n';
}

function csvCell(value) {
  if (value === null || value === undefined) return '';
  let text = String(value);
  // a spreadsheet would take it for a formula
  if (typeof value === 'string' && /^[=+\-@\t]/.test(text)) text = `'${text}`;
  return /[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}

const escaped = (text) => String(text).replace(/[<>&"']/g, (c) => `&#${c.charCodeAt(0)};`);

export function toKml(product, items) {
  const marks = items.map((item) => {
    let shape = '';
    if (isKnown(item)) {
      const text = (places) => places.map((p) => p.join(',')).join(' ');
      const places = item.result.points.map(position);
      // heights of the project are no heights above the sea of KML: shapes lie on the ground, heights are data
      if (item.kind === 'point') shape = `<Point><coordinates>${text(places)}</coordinates></Point>`;
      else if (item.kind === 'area') {
        shape = `<Polygon><outerBoundaryIs><LinearRing><coordinates>${text([...places, places[0]])}</coordinates></LinearRing></outerBoundaryIs></Polygon>`;
      } else shape = `<LineString><tessellate>1</tessellate><coordinates>${text(places)}</coordinates></LineString>`;
    }
    const data = {
      ...resultRecord(item), crs: crsText(product), kind: item.kind,
      vertices: JSON.stringify(item.vertices.map((_, k) => vertexRecord(product, item, k))),
    };
    const extended = Object.entries(data).map(([key, value]) =>
      `<Data name="${escaped(key)}"><value>${escaped(value)}</value></Data>`).join('');
    return `<Placemark><name>${escaped(item.name)}</name><ExtendedData>${extended}</ExtendedData>${shape}</Placemark>`;
  });
  return `<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document>` +
    `<name>${escaped(product.title || product.name || 'stereomate')}</name>\n${marks.join('\n')}\n</Document></kml>\n`;
}

function verticesOf(product, rows) {
  return rows.map((v) => ({
    left: product.pixelOf(Number(v.left_x), Number(v.left_y)), right: product.pixelOf(Number(v.right_x), Number(v.right_y)),
  }));
}

// What a file holds: measurements, and other features as GeoJSON.
export function fromText(product, name, text) {
  const suffix = name.toLowerCase().split('.').pop();
  if (suffix === 'csv') return { measurements: fromCsv(product, text), features: [] };
  if (suffix === 'kml') return fromKml(product, text);
  return fromGeoJson(product, JSON.parse(text));
}

function fromGeoJson(product, document) {
  const list = document?.type === 'FeatureCollection' ? document.features
    : document?.type === 'Feature' ? [document]
      : document?.coordinates ? [{ type: 'Feature', properties: {}, geometry: document }] : null;
  if (!Array.isArray(list)) throw new Error('no GeoJSON');
  const measurements = [], features = [];
  for (const feature of list) {
    const properties = feature?.properties ?? {};
    if (properties.stereomate && Array.isArray(properties.vertices)) {
      measurements.push({ kind: properties.kind, name: properties.name, vertices: verticesOf(product, properties.vertices) });
    } else if (feature?.geometry) features.push(feature);
  }
  return { measurements, features };
}

// Rows of a CSV, quoted cells and all.
export function csvRows(text) {
  const rows = [];
  let row = [], cell = '', quoted = false;
  for (let k = 0; k < text.length; k++) {
    const c = text[k];
    if (quoted) {
      if (c === '"' && text[k + 1] === '"') { cell += '"'; k++; } else if (c === '"') quoted = false; else cell += c;
    } else if (c === '"') quoted = true;
    else if (c === ',' || c === ';') { row.push(cell); cell = ''; }
    else if (c === '\n' || c === '\r') {
      if (c === '\r' && text[k + 1] === '\n') k++;
      row.push(cell);
      if (row.some((v) => v !== '')) rows.push(row);
      row = [];
      cell = '';
    } else cell += c;
  }
  row.push(cell);
  if (row.some((v) => v !== '')) rows.push(row);
  const [head = [], ...body] = rows;
  return body.map((cells) => Object.fromEntries(head.map((key, k) => [key.trim().toLowerCase().replace(/^\ufeff/, ''), cells[k] ?? ''])));
}

function fromCsv(product, text) {
  const groups = new Map();
  for (const [k, row] of csvRows(text).entries()) {
    if (![row.left_x, row.left_y, row.right_x, row.right_y].every((v) => v !== undefined && v !== '' && Number.isFinite(Number(v)))) {
      throw new Error(`row ${k + 1}: left_x, left_y, right_x and right_y must be numbers`);
    }
    const name = row.measurement || row.name || String(k + 1), key = `${row.kind || 'point'} ${row.measurement ? name : k}`;
    if (!groups.has(key)) groups.set(key, { kind: row.kind || 'point', name, rows: [] });
    groups.get(key).rows.push(row);
  }
  return [...groups.values()].map(({ kind, name, rows }) => ({ kind, name, vertices: verticesOf(product, rows) }));
}

function fromKml(product, text) {
  const document = new DOMParser().parseFromString(text, 'application/xml');
  if (document.querySelector('parsererror')) throw new Error('no KML');
  const measurements = [], features = [];
  for (const mark of document.getElementsByTagName('Placemark')) {
    const data = Object.fromEntries([...mark.getElementsByTagName('Data')].map((d) =>
      [d.getAttribute('name'), d.getElementsByTagName('value')[0]?.textContent ?? '']));
    const name = mark.getElementsByTagName('name')[0]?.textContent ?? '';
    if (data.vertices && Object.hasOwn(KINDS, data.kind)) {
      measurements.push({ kind: data.kind, name, vertices: verticesOf(product, JSON.parse(data.vertices)) });
      continue;
    }
    for (const [tag, type] of [['Point', 'Point'], ['LineString', 'LineString'], ['LinearRing', 'LineString']]) {
      for (const shape of mark.getElementsByTagName(tag)) {
        const places = (shape.getElementsByTagName('coordinates')[0]?.textContent ?? '').trim().split(/\s+/)
          .map((p) => p.split(',').map(Number));
        features.push({ type: 'Feature', properties: { name }, geometry: { type, coordinates: type === 'Point' ? places[0] : places } });
      }
    }
  }
  return { measurements, features };
}
