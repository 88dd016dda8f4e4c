// The submaps of a map on top of each other, closures by how far the poses contradict them, and what is selected.

/** Closures that are off by this much have the last colour, metres. */
const FAR_OFF = 0.5;
/** Around the box of a piece of surface, points may still be of it, metres. */
const AROUND = 0.5;

/** The product of two quaternions: b first. */
const turnedBy = (a, b) => {
  const [u, v] = [a.slice(0, 3), b.slice(0, 3)];
  return [...add(add(scaled(v, a[3]), scaled(u, b[3])), cross(u, v)), a[3] * b[3] - dot(u, v)];
};

/** The colour of a closure. */
function offColour(off) {
  const stops = DATA.ramps.error;
  return hex(stops[Math.round(Math.min(off / FAR_OFF, 1) * (stops.length - 1))]);
}

class EditView extends LiveView {
  constructor(canvas) {
    super(canvas);
    this.lines.region = this.lineSet();
    this.lines.gizmo = this.lineSet();
    this.lines.measured = this.lineSet();
    Object.assign(this.show, { mode: 1, path: true, loops: true, region: true, gizmo: true, measured: true, changes: false });
    // `local` is what the pointer moves, until the server knows; `instead` poses that are shown for comparison.
    Object.assign(this, { follow: false, selected: [], closures: [], pointed: -1, region: null, local: null, instead: null, serverPoses: new Map(), gizmo: null, measured: [], changes: new Map() });
  }

  /** Saves the picture as it is seen, finely drawn; resolves to its size in bytes. */
  savePicture(name) {
    this.refresh();
    Stage.prototype.render.call(this, true);
    return new Promise((done) => this.canvas.toBlob((blob) => {
      const link = el("a", { href: URL.createObjectURL(blob), download: `${name}.png` });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
      done(blob.size);
    }, "image/png"));
  }

  *surfaces() {
    const [first, second] = this.selected, bytes = (name) => rgb(themed(name)).map((c) => c * 255);
    const [accent, warm, soft] = ["--accent", "--warm", "--soft"].map(bytes);
    for (const s of super.surfaces()) {
      const change = this.changes.get(s.submap);
      if (this.show.changes) yield { ...s, mode: 1, colour: !change ? soft : change.moved_m > 0 ? rgb(offColour(change.moved_m)).map((c) => c * 255) : warm };
      else if (first === undefined) yield s;
      else yield { ...s, mode: 1, colour: s.submap === first ? accent : s.submap === second ? warm : soft };
    }
  }

  setTile(key, tile) {
    super.setTile(key, tile);
    const kept = this.tiles.get(key);
    if (kept) kept.chunks = tile.chunks;
  }

  /** Poses as the server has them. */
  setSubmaps(poses) {
    this.serverPoses = poses;
    this.arrange();
  }

  /** The poses that are shown. */
  arrange() {
    const poses = new Map(this.instead || this.serverPoses);
    if (this.local && poses.has(this.local.submap)) poses.set(this.local.submap, this.local.pose);
    super.setSubmaps(poses);
    this.selected = this.selected.filter((id) => poses.has(id));
  }

  refresh() {
    const { stale } = this;
    if (this.asked) [this.drawn_for, this.asked] = [this.asked, 0];
    super.refresh();
    this.fill(this.lines.gizmo, this.gizmo?.segments() || []);
    if (!stale) return;
    this.fill(this.lines.measured, this.measured);
    this.fill(this.lines.loops, this.closures.map(({ ends, off_m }, i) => [...ends, offColour(off_m), i === this.pointed ? 8 : 3.5]));
    const { region } = this, warm = themed("--warm");
    const ring = region ? region.z.map((z) => region.polygon.map(([x, y]) => [x, y, z])) : [[], []];
    const around = (points) => points.map((p, i) => [p, points[(i + 1) % points.length], warm, 3]);
    this.fill(this.lines.region, [...around(ring[0]), ...around(ring[1]), ...ring[0].map((p, i) => [p, ring[1][i], warm, 1.5])]);
  }

  /** Where the eye looks at a place of the canvas: a direction. */
  ray(x, y) {
    const [across, up] = this.axes(), tall = Math.tan(FOV / 2), { clientWidth: w, clientHeight: h } = this.canvas;
    const ahead = unit(sub(this.camera.target, this.eye()));
    return add(ahead, add(scaled(across, ((2 * x) / w - 1) * tall * (w / h)), scaled(up, (1 - (2 * y) / h) * tall)));
  }

  /** The point at a height that a place of the canvas shows; null where there is none. */
  onPlane(x, y, z) {
    const eye = this.eye(), d = this.ray(x, y), t = (z - eye[2]) / d[2];
    return t > 0 && Number.isFinite(t) ? add(eye, scaled(d, t)) : null;
  }

  /** The submap whose surface is at a place of the canvas, if any. */
  submapAt(x, y) {
    const point = this.pick(x, y);
    let found = null, nearest = Infinity;
    for (const { submap, origin, step, size, chunks } of point ? this.tiles.values() : []) {
      const local = sub(movedBack(this.submaps.get(submap), point), origin);
      if (local.some((c, k) => c < -AROUND || c > size[k] + AROUND)) continue;
      for (const { vertices } of chunks) {
        const words = new Uint16Array(vertices.buffer);
        for (let at = 0; at < words.length; at += STRIDE / 2) {
          const d = (words[at] * step - local[0]) ** 2 + (words[at + 1] * step - local[1]) ** 2 + (words[at + 2] * step - local[2]) ** 2;
          if (d < nearest) [nearest, found] = [d, submap];
        }
      }
    }
    return found;
  }

  /** The camera goes to a place. */
  lookAtPlace(target) {
    this.fly({ ...this.camera, target, distance: Math.min(this.camera.distance, 25) });
  }
}
