// The page: opens a product and ties picture, mark, measurements and controls together.

import { $, notice } from './ui/dom.js';
import { fetchJson } from './files.js';
import { Product } from './product.js';
import { App } from './ui/app.js';
import { Unsupported, begin } from './view/renderer.js';

// A picture that takes longer is not waited for.
const LATE_MS = 500;

function fail(text) {
  $('app').hidden = true;
  $('message').textContent = text;
  $('message').className = 'said';
}

async function start() {
  const listed = fetchJson('data/products.json'), begun = begin($('view'));
  const { products } = await listed;
  const wanted = new URLSearchParams(location.search).get('product');
  const entry = products.find((p) => p.name === wanted) ?? products[0];
  const product = await Product.open(`data/${entry.folder}`);
  $('message').textContent = '';
  // laid out, and seen together with the first picture: a frame without it would hold that up
  $('app').classList.add('starting');
  $('app').hidden = false;
  setTimeout(() => $('app').classList.remove('starting'), LATE_MS);
  const app = new App(begun, product, products, entry);
  window.stereomate = app;
  await app.start();
}

// not awaited: the browser draws nothing before the module has ended
start().catch((error) => {
  if (error instanceof Unsupported) {
    fail('This browser shows no WebGL2, which the stereo picture needs. Try a current Firefox, Chrome, Edge or Safari, ' +
      'and look whether hardware acceleration is switched off in its settings.');
  } else {
    fail(`The product cannot be opened: ${error.message}`);
  }
  notice('');
});
