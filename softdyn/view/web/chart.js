"use strict";
// Curves over time on a canvas: the strips beside a live robot, and the timeline of a replay.

const SPARE = 5;  // pixels above and below the curves
const SLOTS = 300;  // about one for each pixel of a strip
const THICK = 1.3;  // pixels of a curve
const NUMBER = 10;  // least distance (pixels) of two numbers of the vertical axis

/**
 * Columns of numbers over the last seconds, in slots of time.
 *
 * A slot keeps the time of its first row and the extremes of each column. A drawing therefore costs
 * the same for seconds and for minutes. Slots begin at multiples of their length, so a curve that
 * moves to the left keeps its shape.
 */
class Slots {
  /**
   * @param {string[]} names of the columns
   * @param {number} span seconds that are kept at least
   * @param {number} [count] number of slots
   */
  constructor(names, span, count = SLOTS) {
    Object.assign(this, {names, span, count, size: span / (count - 1)});
    // twice as long as needed: when they are full, the newer half becomes the older one
    const column = () => new Float32Array(2 * count);
    this.times = column();
    this.least = Object.fromEntries(names.map(name => [name, column()]));
    this.most = Object.fromEntries(names.map(name => [name, column()]));
    this.clear();
  }
  clear() { this.first = this.end = 0; }
  get length() { return this.end - this.first; }

  /** The ends of the time that is shown: the span, or from the first row. */
  get shown() {
    return [Math.max(this.last - this.span, this.times[this.first]), this.last];
  }

  /**
   * @param {number} t time (s), not before that of the last row
   * @param {Object<string, number>} row a number for each column; one that is not finite is a gap
   */
  push(t, row) {
    const slot = Math.floor(t / this.size);
    if (!this.length || slot != this.slot) this.begin(t);
    const k = this.end - 1;
    for (const name of this.names) {
      const value = row[name], [least, most] = [this.least[name], this.most[name]];
      if (!Number.isFinite(value)) continue;
      if (!(least[k] <= value)) least[k] = value;  // also if it is NaN
      if (!(most[k] >= value)) most[k] = value;
    }
    this.slot = slot;
    this.last = t;
  }
  begin(t) {
    const columns = [this.times, ...Object.values(this.least), ...Object.values(this.most)];
    if (this.end == 2 * this.count) {
      for (const column of columns) column.copyWithin(0, this.first);
      [this.first, this.end] = [0, this.length];
    }
    for (const column of columns) column[this.end] = NaN;
    this.times[this.end++] = t;
    this.first = Math.max(this.first, this.end - this.count);
  }

  /** @returns {{t: Float32Array, least: Float32Array, most: Float32Array}} the slots of a column */
  column(name) {
    const part = column => column.subarray(this.first, this.end);
    return {t: part(this.times), least: part(this.least[name]), most: part(this.most[name])};
  }
}

/** Round numbers (1, 2 or 5 times a power of ten) between two ends, about `count` of them. */
function roundNumbers(low, high, count) {
  const least = Math.max((high - low) / Math.max(count, 1), 1e-12);
  const power = 10 ** Math.floor(Math.log10(least));
  const step = power * [1, 2, 5, 10].find(x => x * power >= least * (1 - 1e-9));
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(k * step);
  return found;
}

/** Powers of ten between two ends, and 0 if it is there; at most four of each sign. */
function powersOfTen(low, high) {
  const most = Math.floor(Math.log10(Math.max(-low, high, 1e-12)) + 1e-9);
  const least = low > 0 ? Math.ceil(Math.log10(low) - 1e-9) : most - 2;
  const skip = Math.max(1, Math.ceil((most - least) / 3)), found = low > 0 ? [] : [0];
  for (let k = most; k >= least; k -= skip) found.push(10 ** k, -(10 ** k));
  return found.filter(x => x >= low && x <= high).sort((a, b) => a - b);
}

// Scales of the vertical axis. `place` is proportional to the height of a value, `ends` are the
// ends of the axis for values between low and high, `ticks` are values with a line and a number.

/** A scale whose ends are at least `least` apart and not above `from`. */
class Linear {
  constructor(least, from = Infinity) { Object.assign(this, {least, from}); }
  place(y) { return y; }
  ends(low, high) {
    const first = Math.min(low, this.from);
    return [first, Math.max(high, first + this.least)];
  }
  ticks(low, high, count) { return roundNumbers(low, high, count); }
}

/** A scale of whole powers of ten; values below `least` are drawn there. */
class Logarithmic {
  constructor(least) { this.least = least; }
  place(y) { return Math.log10(Math.max(y, this.least)); }
  ends(low, high) {
    const [first, last] = [Math.floor(this.place(low)), Math.ceil(this.place(high))];
    return [10 ** first, 10 ** Math.max(last, first + 1)];
  }
  ticks(low, high) { return powersOfTen(low, high); }
}

/** A scale for both signs, with 0 in it: linear up to `small`, logarithmic beyond. */
class Symmetric {
  constructor(small) { this.small = small; }
  place(y) { return Math.asinh(y / this.small); }
  ends(low, high) { return [Math.min(low, 0), Math.max(high, this.small)]; }
  ticks(low, high) { return powersOfTen(low, high); }
}

/** A number of an axis, in as few characters as tell it from one that is a `step` away. */
function short(x, step) {
  if (x == 0) return "0";
  const size = Math.floor(Math.log10(Math.abs(x)) + 1e-9);
  const digits = Math.max(0, Math.min(size - Math.floor(Math.log10(step) + 1e-9), 15));
  if (size >= 4 || size < -2) return x.toExponential(digits).split("e").map(Number).join("e");
  return String(Number(x.toPrecision(Math.max(3, digits + 1))));
}

/**
 * Curves over time on a canvas.
 */
class Chart {
  /**
   * @param {HTMLCanvasElement} canvas as large as its style says
   * @param {Linear|Logarithmic|Symmetric} scale
   * @param {object} [axes]
   * @param {number} [axes.left] width (pixels) for the numbers of the vertical axis; 0: no axis
   * @param {number} [axes.bottom] height (pixels) for the numbers of the time axis; 0: no axis
   * @param {number[]} [axes.marks] values with a dashed line
   */
  constructor(canvas, scale, {left = 0, bottom = 0, marks = []} = {}) {
    Object.assign(this, {canvas, scale, left, bottom, marks});
    // drawn by the processor, because that is fast enough for few pixels anywhere
    this.pen = canvas.getContext("2d", {willReadFrequently: true});
  }

  /**
   * @param {{t: Float32Array, least: Float32Array, most: Float32Array, colour: string}[]} curves
   * @param {number} from time at the left end
   * @param {number} to time at the right end
   */
  draw(curves, from, to) {
    this.fit();
    let [low, high] = [Infinity, -Infinity];
    const include = (least, most) => {
      if (least < low) low = least;
      if (most > high) high = most;
    };
    for (const value of this.marks) include(value, value);
    for (const {t, least, most} of curves)
      for (let k = 0; k < t.length; k++) if (t[k] >= from) include(least[k], most[k]);
    this.setRange(from, to, low <= high ? this.scale.ends(low, high) : this.scale.ends(0, 0));
    this.drawAxes();
    this.pen.save();
    this.pen.beginPath();
    this.pen.rect(this.left, 0, this.width, this.height);
    this.pen.clip();
    this.drawMarks();
    for (const curve of curves) this.drawCurve(curve);
    this.pen.restore();
  }

  /** Gives the canvas the pixels of the screen. */
  fit() {
    const {canvas} = this, ratio = devicePixelRatio || 1;
    const [wide, high] = [canvas.clientWidth, canvas.clientHeight];
    const [columns, rows] = [Math.round(wide * ratio), Math.round(high * ratio)];
    if (canvas.width != columns) canvas.width = columns;
    if (canvas.height != rows) canvas.height = rows;
    this.pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.pen.clearRect(0, 0, wide, high);
    this.width = Math.max(1, wide - this.left);
    this.height = Math.max(1, high - this.bottom);
  }

  setRange(from, to, [low, high]) {
    Object.assign(this, {from, to, low, high});
    const [bottom, top] = [this.scale.place(low), this.scale.place(high)];
    const across = this.width / (to - from || 1);
    const up = Math.max(this.height - 2 * SPARE, 1) / (top - bottom || 1);
    this.x = t => this.left + (t - from) * across;
    this.y = value => this.height - SPARE - (this.scale.place(value) - bottom) * up;
  }

  drawAxes() {
    const {pen} = this;
    pen.font = "10px system-ui, sans-serif";
    pen.lineWidth = 1;
    pen.strokeStyle = "#dde3ea";
    pen.fillStyle = "#5d6b7a";
    const line = (a, b, c, d) => {
      pen.beginPath();
      pen.moveTo(a, b);
      pen.lineTo(c, d);
      pen.stroke();
    };
    if (this.left) {
      pen.textAlign = "right";
      pen.textBaseline = "middle";
      const lines = [], ticks = this.scale.ticks(this.low, this.high, this.height / 20);
      const steps = ticks.slice(1).map((value, i) => value - ticks[i]);
      const step = Math.min(...steps.map(Math.abs), Math.abs(ticks[0]) || Infinity);
      for (const value of ticks.sort((a, b) => Math.abs(a) - Math.abs(b))) {
        const y = Math.round(this.y(value)) + 0.5;
        if (lines.some(other => Math.abs(other - y) < NUMBER)) continue;
        lines.push(y);
        line(this.left, y, this.left + this.width, y);
        pen.fillText(short(value, step), this.left - 3, y);
      }
    }
    if (this.bottom) {
      pen.textAlign = "center";
      pen.textBaseline = "bottom";
      for (const t of roundNumbers(this.from, this.to, this.width / 60)) {
        const x = Math.round(this.x(t)) + 0.5;
        line(x, 0, x, this.height);
        pen.fillText(String(Number(t.toFixed(6))), x, this.height + this.bottom);
      }
    }
  }

  drawMarks() {
    const {pen} = this;
    pen.strokeStyle = "#8a94a0";
    pen.lineWidth = 1;
    pen.setLineDash([4, 4]);
    for (const value of this.marks) {
      pen.beginPath();
      pen.moveTo(this.left, this.y(value));
      pen.lineTo(this.left + this.width, this.y(value));
      pen.stroke();
    }
    pen.setLineDash([]);
  }

  /** A bar from the least to the largest number of each slot, and a line from bar to bar. */
  drawCurve({t, least, most, colour}) {
    const {pen} = this;
    pen.strokeStyle = pen.fillStyle = colour;
    pen.lineWidth = THICK;
    pen.lineJoin = "bevel";
    pen.beginPath();
    let last = NaN;  // height of the line's end; NaN after a gap
    for (let k = 0; k < t.length; k++) {
      const x = this.x(t[k]), [low, high] = [this.y(least[k]), this.y(most[k])];
      const near = Math.min(Math.max(last, high), low);
      if (Number.isNaN(near)) pen.moveTo(x, low);
      else pen.lineTo(x, near);
      if (low - high > THICK) pen.fillRect(x - THICK / 2, high, THICK, low - high);
      last = Number.isNaN(near) ? low : near;
    }
    pen.stroke();
  }
}
