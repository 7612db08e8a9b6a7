"use strict";

/**
 * The last rows of some columns of numbers.
 *
 * Each column is twice as long as needed: when it is full its newer half becomes the older one.
 * Adding a row is therefore cheap, and a column is always one piece of memory, oldest row first.
 */
class Recent {
  /**
   * @param {string[]} names of the columns
   * @param {number} most number of rows
   */
  constructor(names, most) {
    this.most = most;
    this.columns = Object.fromEntries(names.map(name => [name, new Float32Array(2 * most)]));
    this.clear();
  }
  clear() { this.first = this.end = 0; }
  get length() { return this.end - this.first; }

  /** @param {Object<string, number>} row a number for each column */
  push(row) {
    const columns = Object.entries(this.columns);
    if (this.end == 2 * this.most) {
      for (const [, column] of columns) column.copyWithin(0, this.first);
      [this.first, this.end] = [0, this.length];
    }
    for (const [name, column] of columns) column[this.end] = row[name];
    this.end++;
    this.first = Math.max(this.first, this.end - this.most);
  }

  /** A view of a column, valid until the next row. */
  column(name) { return this.columns[name].subarray(this.first, this.end); }

  /** The newest number of a column; NaN before the first row. */
  last(name) { return this.length ? this.columns[name][this.end - 1] : NaN; }
}
