// Lengths, angles, areas and heights between points that are picked on surfaces.

/** What is level around a point: so far around, in steps so high, metres, and of at least this share of the fullest step. */
const AROUND_LEVEL = 3;
const LEVEL_STEP = 0.25;
const LEVEL_SHARE = 0.5;
/** Least upward part of the normal of a floor. */
const UPWARD = 0.8;

class Measure {
  constructor(view) {
    Object.assign(this, { view, points: [] });
  }

  add(point) {
    if (point) this.points.push(point);
    this.changed();
    return Boolean(point);
  }

  back() { this.points.pop(); this.changed(); }
  clear() { this.points = []; this.changed(); }

  changed() {
    const { view, points } = this;
    const closing = points.length > 2 ? [[points.at(-1), points[0], themed("--soft"), 2]] : [];
    view.measured = [...points.slice(1).map((p, i) => [points[i], p, themed("--gold"), 5]), ...closing,
      ...points.flatMap((p) => [0, 1, 2].map((k) => [0, 1, 2].map((i) => (i === k ? 1 : 0))).map((axis) => [sub(p, scaled(axis, this.cross())), add(p, scaled(axis, this.cross())), themed("--gold"), 4]))];
    view.stale = true;
    view.draw();
    this.show();
  }

  /** Half of the cross at a point, metres. */
  cross() { return 6 * this.view.metresPerPixel(); }

  /** The figures: names and values. */
  figures(origin) {
    const { points } = this, last = points.at(-1), rows = [];
    if (!last) return rows;
    const metres = (m) => `${m.toFixed(3)} m`, degrees = (d) => `${d.toFixed(1)}°`;
    rows.push(["Point", add(last, origin).map((c) => c.toFixed(2)).join(" ")]);
    const level = this.levelAt(last);
    rows.push(["Above the ground", level === null ? "not known" : `${(last[2] - level).toFixed(2)} m`]);
    if (points.length < 2) return rows;
    const d = sub(last, points.at(-2));
    rows.push(["Distance", metres(Math.hypot(...d))], ["level", metres(Math.hypot(d[0], d[1]))], ["up", metres(d[2])]);
    if (points.length < 3) return rows;
    rows.push(["Length of all", metres(points.slice(1).reduce((sum, p, i) => sum + Math.hypot(...sub(p, points[i])), 0))]);
    const back = unit(sub(points.at(-3), points.at(-2)));
    rows.push(["Angle", degrees((Math.acos(Math.min(Math.max(dot(unit(d), back), -1), 1)) * 180) / Math.PI)]);
    const area = points.slice(2).reduce((sum, p, i) => add(sum, cross(sub(points[i + 1], points[0]), sub(p, points[0]))), [0, 0, 0]);
    rows.push(["Area", `${(Math.hypot(...area) / 2).toFixed(2)} m²`]);
    return rows;
  }

  show() {
    const rows = this.figures(this.origin || [0, 0, 0]);
    byId("measures").replaceChildren(...rows.flatMap(([name, value]) => [el("dt", {}, name), el("dd", {}, value)]));
    byId("measure-help").hidden = rows.length > 0;
  }

  /** The height of the floor around a point, which is at it or below; null where none is seen. */
  levelAt([x, y, z]) {
    const counts = new Map();
    for (const { matrix: m, centre, radius, chunks } of this.view.tiles.values()) {
      if (Math.hypot(centre[0] - x, centre[1] - y) > radius + AROUND_LEVEL) continue;
      const size = Math.hypot(m[0], m[1], m[2]);
      for (const { vertices } of chunks) {
        const words = new Uint16Array(vertices.buffer), bytes = new Uint8Array(vertices.buffer);
        for (let at = 0; at < bytes.length; at += STRIDE) {
          const [u, v, w] = [words[at / 2], words[at / 2 + 1], words[at / 2 + 2]];
          const dx = m[0] * u + m[4] * v + m[8] * w + m[12] - x, dy = m[1] * u + m[5] * v + m[9] * w + m[13] - y;
          if (dx * dx + dy * dy > AROUND_LEVEL * AROUND_LEVEL) continue;
          const height = m[2] * u + m[6] * v + m[10] * w + m[14];
          if (height > z + LEVEL_STEP) continue;
          const up = upwards(bytes[at + 6], bytes[at + 7], m, size);
          if (up < UPWARD) continue;
          const step = Math.floor((height - z) / LEVEL_STEP), of = counts.get(step) || [];
          of.push(height);
          counts.set(step, of);
        }
      }
    }
    const fullest = most([...counts.values()].map((of) => of.length));
    const levels = [...counts].filter(([, of]) => of.length >= LEVEL_SHARE * fullest).sort(([a], [b]) => b - a);
    return levels.length ? quantile(levels[0][1], 0.5) : null;
  }
}

/** How much the normal of a vertex points up, as the shader reads it. */
function upwards(a, b, m, size) {
  const f = [(a / 255) * 2 - 1, (b / 255) * 2 - 1], n = [f[0], f[1], 1 - Math.abs(f[0]) - Math.abs(f[1])], t = Math.max(-n[2], 0);
  n[0] += n[0] >= 0 ? -t : t;
  n[1] += n[1] >= 0 ? -t : t;
  return (m[2] * n[0] + m[6] * n[1] + m[10] * n[2]) / (size * Math.hypot(...n));
}
