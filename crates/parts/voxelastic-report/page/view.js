// The surface of a report: submaps that bend, trajectory, loops. What the reader does to it is in controls.js.

class View extends Stage {
  constructor(canvas, chunks) {
    super(canvas);
    const mode = DATA.surfaces.some((s) => s.has_colours) ? COLOURS.findIndex((c) => c.wants === "has_colours") : 0;
    Object.assign(this.show, { mode, path: !DATA.exploration, loops: true, plan: true, moving: false, exploration: true, bend: 1 });
    this.submaps = DATA.surfaces.map((s, i) => ({ ...s, parts: chunks[i].map((c) => this.upload(c)) }));
    this.bounds = boundsOf(chunks);
    this.lines = { path: this.lineSet(), loops: this.lineSet(), plan: this.lineSet(), moving: this.lineSet(), exploration: this.lineSet() };
    this.shownMoving = [0, DATA.moving.length - 1];
    this.bend(1);
    this.reset(true);
  }

  surfaces() { return this.submaps; }

  /** Puts submaps where they lay before corrections (0), where they lie (1), or between; the lines follow. */
  bend(share) {
    this.show.bend = share;
    const poses = new Map();
    for (const s of this.submaps) {
      s.now = s.first_pose && share < 1 ? between(s.first_pose, s.pose, share) : s.pose;
      s.matrix = poseMatrix(s.now, s.origin, s.step);
      poses.set(s.submap, s);
    }
    const { position, submap, node } = DATA.nodes;
    this.path = position.map((p, i) => {
      const s = poses.get(submap[i]);
      return s && share < 1 ? moved(s.now, movedBack(s.pose, p)) : p;
    });
    const colours = [themed("--warm"), themed("--violet")];
    this.fill(this.lines.path, this.path.slice(1).map((p, i) => [this.path[i], p, colours[0], 2.6]));
    const at = new Map(node.map((n, i) => [n, this.path[i]]));
    const loops = DATA.run ? DATA.run.loops : [];
    this.fill(this.lines.loops, loops.filter((l) => at.has(l.from) && at.has(l.to)).map((l) => [at.get(l.from), at.get(l.to), colours[1], 3]));
    this.poses = poses;
    this.showMoving(this.shownMoving);
    this.fill(this.lines.plan, DATA.planned_path ? planSegments(DATA.planned_path) : []);
  }

  /** Shows a moment of the exploration. */
  showStep(index) {
    this.fill(this.lines.exploration, explorationSegments(index));
  }

  /** Shows the moving points of a range of the scans that have some. */
  showMoving([first, last]) {
    this.shownMoving = [first, last];
    this.fill(this.lines.moving, movingSegments(this.poses, Math.max(first, 0), last));
  }
}

/** The bulk of the map: all but half a percent of the vertices at either end of each axis; and heights for colours. */
function boundsOf(chunks) {
  const samples = [[], [], []];
  DATA.surfaces.forEach((s, i) => chunks[i].forEach(({ vertices }) => {
    const words = new Uint16Array(vertices.buffer), count = vertices.length / STRIDE;
    for (let v = 0; v < count; v += Math.max(1, Math.floor(count / 4000)))
      moved(s.pose, [0, 1, 2].map((k) => s.origin[k] + s.step * words[(v * STRIDE) / 2 + k])).forEach((c, k) => samples[k].push(c));
  }));
  for (const p of DATA.nodes.position) p.forEach((c, k) => samples[k].push(c));
  const low = samples.map((s) => quantile(s, 0.005)), high = samples.map((s) => quantile(s, 0.995));
  const ground = quantile(samples[2], 0.02), roof = quantile(samples[2], 0.98);
  return { low, high, heights: [ground, Math.max(roof, ground + 0.01)], all: [least(samples[2]), most(samples[2])] };
}

/** A planned path as segments: tree red, path blue, start green, goal red. */
function planSegments(plan) {
  const cross3 = (p, colour) => [[0.5, 0, 0], [0, 0.5, 0], [0, 0, 0.8]].map((d) => [sub(p, d), add(p, d), colour, 5]);
  const joined = (points, colour, width) => points.slice(1).map((p, i) => [points[i], p, colour, width]);
  return [
    ...plan.tree.map(([a, b]) => [a, b, "#d23b3b", 1.2]),
    ...joined(plan.path, "#2f6fe0", 4.5),
    ...(plan.start ? cross3(plan.start, "#2aa745") : []),
    ...(plan.goal ? cross3(plan.goal, "#d8262c") : []),
  ];
}
