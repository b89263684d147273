// The floating mark: a place on the orthophoto and one on the stereomate.

export class Mark {
  constructor(product) {
    this.product = product;
    this.left = null;
    this.raised = 0;       // parallax above the ground, product pixels
    this.down = 0;         // rows by which the right place lies lower
    this.onGround = true;  // follows the height model; else it keeps its parallax
    this.parallax = 0;
  }

  get right() {
    return this.left && [this.left[0] - this.parallax, this.left[1] + this.down];
  }

  #ground(col, row) {
    const exact = this.product.groundNow(col, row);
    const h = Number.isFinite(exact) ? exact : this.product.relief?.height(col, row) ?? NaN;
    return this.product.stereo ? this.product.parallaxOfHeight(h) : 0;
  }

  // Move to a place of the orthophoto. What is set by correlation stays until it is moved.
  moveTo(col, row) {
    this.left = [col, row];
    this.down = 0;
    this.matched = null;
    this.refresh();
  }

  // Take the ground again, now that its heights are there.
  refresh() {
    if (!this.left || this.matched) return;
    if (this.onGround) {
      const ground = this.#ground(...this.left);
      if (Number.isFinite(ground)) this.parallax = ground + this.raised;
    }
  }

  raise(pixels) {
    this.raised += pixels;
    this.parallax += pixels;
    this.matched = null;
  }

  toGround() {
    this.raised = 0;
    this.down = 0;
    this.matched = null;
    this.onGround = true;
    this.refresh();
  }

  setMatched(right, found) {
    this.parallax = this.left[0] - right[0];
    this.down = right[1] - this.left[1];
    this.matched = found;
    const ground = this.#ground(...this.left);
    if (Number.isFinite(ground)) this.raised = this.parallax - ground;
  }

  set(left, right) {
    this.left = [...left];
    this.parallax = left[0] - right[0];
    this.down = right[1] - left[1];
    this.matched = { score: NaN };
  }
}
