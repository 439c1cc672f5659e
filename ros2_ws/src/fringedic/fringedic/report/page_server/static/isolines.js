// Lines of equal value on a map (marching squares), and round values for them.

const FINEST = 300; // points along the longer side; a map with more is sampled

// Round values between two limits, about ten.
export function levelsBetween(low, high) {
  const rough = (high - low) / 10, power = 10 ** Math.floor(Math.log10(rough)), pace = power * [1, 2, 5, 10].find((each) => each * power >= rough);
  const levels = [];
  if (!(pace > 0)) return { pace: NaN, levels };
  for (let k = Math.ceil(low / pace); k * pace <= high; k++) levels.push(k * pace);
  return { pace, levels };
}

// The lines as the path of an SVG, in pixels of the reference image from the left and upper border.
export function isolines({ values, rows, columns, spacing }, levels) {
  const every = Math.max(1, Math.ceil(Math.max(rows, columns) / FINEST)), parts = [];
  const at = (index) => ((index + 0.5) * spacing).toFixed(1);
  for (let row = 0; row + every < rows; row += every) {
    for (let column = 0; column + every < columns; column += every) {
      const corners = [[row, column], [row, column + every], [row + every, column + every], [row + every, column]];
      const found = corners.map(([r, c]) => values[r * columns + c]);
      if (found.some(Number.isNaN)) continue; // a line ends where the map is not measured
      const low = Math.min(...found), high = Math.max(...found);
      for (const level of levels) {
        if (level <= low || level > high) continue;
        const crossings = corners.flatMap(([r, c], k) => {
          const next = (k + 1) % 4, [a, b] = [found[k], found[next]];
          if (a < level === b < level) return [];
          const share = (level - a) / (b - a), [r2, c2] = corners[next];
          return [`${at(c + share * (c2 - c))} ${at(r + share * (r2 - r))}`];
        });
        for (let k = 0; k + 1 < crossings.length; k += 2) parts.push(`M${crossings[k]}L${crossings[k + 1]}`);
      }
    }
  }
  return parts.join("");
}
