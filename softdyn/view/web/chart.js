"use strict";
// Curves over time on a canvas: the strips beside a live robot, and the timeline of a replay.

const SPARE = 5;  // pixels above and below the curves
const NUMBER = 10;  // least distance (pixels) of two numbers of the vertical axis

/** Index of the first value that is not below x, in an array that grows. */
function atOrAfter(values, x) {
  let low = 0, high = values.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle] < x) low = middle + 1;
    else high = middle;
  }
  return low;
}

/**
 * The samples that a drawing needs: the first, least, largest and last one of each interval of time.
 *
 * Intervals begin at multiples of their length, so a curve that moves to the left keeps its shape.
 *
 * @param {ArrayLike<number>} t times that grow
 * @param {ArrayLike<number>} y values; NaN is a gap
 * @param {number} begin index of the first sample
 * @param {number} end index after the last sample
 * @param {number} length of an interval, that of a pixel
 * @returns {number[]} indices that grow
 */
function thinned(t, y, begin, end, length) {
  const found = [];
  for (let first = begin; first < end;) {
    const next = (Math.floor(t[first] / length) + 1) * length;
    let low = first, high = first, last = first;
    for (; last + 1 < end && t[last + 1] < next; last++) {
      const value = y[last + 1];
      if (value < y[low] || Number.isNaN(y[low])) low = last + 1;
      if (value > y[high] || Number.isNaN(y[high])) high = last + 1;
    }
    for (const i of [first, Math.min(low, high), Math.max(low, high), last])
      if (!found.length || i > found[found.length - 1]) found.push(i);
    first = last + 1;
  }
  return found;
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

/** A scale for both signs: linear up to `small`, logarithmic beyond. */
class Symmetric {
  constructor(small) { this.small = small; }
  place(y) { return Math.asinh(y / this.small); }
  ends(low, high) { return [low, Math.max(high, low + this.small)]; }
  ticks(low, high) { return powersOfTen(low, high); }
}

/** A number of an axis in few characters. */
function short(x) {
  if (x == 0) return "0";
  if (Math.abs(x) >= 1e4 || Math.abs(x) < 1e-2) return x.toExponential(0).replace("e+", "e");
  return String(Number(x.toPrecision(3)));
}

/**
 * Curves over time on a canvas. The cost of a drawing depends on its width: of many samples within
 * a pixel only the extremes are drawn.
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
    this.pen = canvas.getContext("2d");
  }

  /**
   * @param {{t: ArrayLike<number>, y: ArrayLike<number>, colour: string}[]} curves
   * @param {number} from time at the left end
   * @param {number} to time at the right end
   */
  draw(curves, from, to) {
    this.fit();
    const pixel = (to - from) / this.width;
    const samples = curves.map(({t, y}) => {
      const begin = Math.max(0, atOrAfter(t, from) - 1);  // the line enters from the left
      return thinned(t, y, begin, Math.min(t.length, atOrAfter(t, to) + 1), pixel);
    });
    let [low, high] = [Infinity, -Infinity];
    const include = y => {
      if (y < low) low = y;
      if (y > high) high = y;
    };
    this.marks.forEach(include);
    curves.forEach(({y}, k) => { for (const i of samples[k]) include(y[i]); });
    this.setRange(from, to, low <= high ? this.scale.ends(low, high) : this.scale.ends(0, 0));
    this.drawAxes();
    this.pen.save();
    this.pen.beginPath();
    this.pen.rect(this.left, 0, this.width, this.height);
    this.pen.clip();
    this.drawMarks();
    curves.forEach((curve, k) => this.drawCurve(curve, samples[k]));
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
      for (const value of ticks.sort((a, b) => Math.abs(a) - Math.abs(b))) {
        const y = Math.round(this.y(value)) + 0.5;
        if (lines.some(other => Math.abs(other - y) < NUMBER)) continue;
        lines.push(y);
        line(this.left, y, this.left + this.width, y);
        pen.fillText(short(value), this.left - 3, y);
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

  drawCurve({t, y, colour}, indices) {
    const {pen} = this;
    pen.strokeStyle = colour;
    pen.lineWidth = 1.3;
    pen.lineJoin = "round";
    pen.beginPath();
    let drawn = false;  // whether the pen is down
    for (const i of indices) {
      if (Number.isNaN(y[i])) drawn = false;
      else if (drawn) pen.lineTo(this.x(t[i]), this.y(y[i]));
      else {
        pen.moveTo(this.x(t[i]), this.y(y[i]));
        drawn = true;
      }
    }
    pen.stroke();
  }
}
