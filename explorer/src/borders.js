/** Borders on a map between runs that settle, that settle beyond a limit, and all others; endings are names of the map's colours. */
const SETTLED = ["settled", "settled, beyond a limit"];

/** Which of the three an ending is. */
const sortOf = (ending) => SETTLED.indexOf(ending);

/**
 * Edges between neighbouring cells of another sort: [x, y, x, y] of both ends [cells], from the lower left corner of the map.
 * @param {number} size cells of a side
 * @param {(x: number, y: number) => string | undefined} endingAt of a cell; undefined where there is no run yet
 */
export function borders(size, endingAt) {
  const found = [];
  const differ = (one, other) => one !== undefined && other !== undefined && sortOf(one) !== sortOf(other);
  for (let y = 0; y < size; ++y)
    for (let x = 0; x < size; ++x) {
      const ending = endingAt(x, y);
      if (x + 1 < size && differ(ending, endingAt(x + 1, y))) found.push([x + 1, y, x + 1, y + 1]);
      if (y + 1 < size && differ(ending, endingAt(x, y + 1))) found.push([x, y + 1, x + 1, y + 1]);
    }
  return found;
}

/** Draws them light within dark, which shows on every colour. */
export function drawBorders(c, edges, size, [left, top, wide, high]) {
  c.beginPath();
  for (const [x0, y0, x1, y1] of edges) {
    c.moveTo(left + (x0 / size) * wide, top + (1 - y0 / size) * high);
    c.lineTo(left + (x1 / size) * wide, top + (1 - y1 / size) * high);
  }
  c.lineCap = "square";
  for (const [style, width] of [["#000", 3], ["#fff", 1.5]]) {
    c.strokeStyle = style;
    c.lineWidth = width;
    c.stroke();
  }
  c.lineCap = "butt";
}

/**
 * The settled cells without a gap around one cell, along an axis.
 * @param {[number, number]} at the cell
 * @param {number} axis 0: across, 1: up
 * @returns {{first: number, last: number, isBeyond: boolean} | null} the cells at both ends, and whether one is beyond a limit; null where the cell itself does not settle
 */
export function settledAround(size, endingAt, at, axis) {
  const sort = (i) => sortOf(endingAt(...at.map((place, k) => (k === axis ? i : place))));
  if (sort(at[axis]) < 0) return null;
  let [first, last] = [at[axis], at[axis]];
  while (first > 0 && sort(first - 1) >= 0) first -= 1;
  while (last < size - 1 && sort(last + 1) >= 0) last += 1;
  return { first, last, isBeyond: Array.from({ length: last - first + 1 }, (_, i) => sort(first + i)).includes(1) };
}
