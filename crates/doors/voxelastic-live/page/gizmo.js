// Handles with which a submap is moved: along the axes of the map, on the plane, and turned about the vertical.

/** Length of a handle, and how near to it the pointer must be, pixels. */
const HANDLE = 90;
const NEAR_HANDLE = { mouse: 11, touch: 24 };
const AXES = [{ name: "x", along: [1, 0, 0], colour: "#d8262c" }, { name: "y", along: [0, 1, 0], colour: "#2aa745" }, { name: "z", along: [0, 0, 1], colour: "#2f6fe0" }];
const TURN = { name: "turn", colour: "#b98a17" };
const PLANE = { name: "plane", colour: "#888888" };

class Gizmo {
  /** `pose` is that of the submap. */
  constructor(view, submap) {
    Object.assign(this, { view, submap });
  }

  pose() { return this.view.submaps.get(this.submap); }

  /** Metres of a handle. */
  length() {
    const { view } = this, away = Math.hypot(...sub(this.pose(), view.eye()).slice(0, 3));
    return HANDLE * view.metresPerPixel() * (away / view.camera.distance);
  }

  ring() {
    const p = this.pose(), r = 0.8 * this.length();
    return Array.from({ length: 33 }, (_, i) => add(p.slice(0, 3), [r * Math.cos((i * Math.PI) / 16), r * Math.sin((i * Math.PI) / 16), 0]));
  }

  segments() {
    if (!this.pose()) return [];
    const p = this.pose().slice(0, 3), length = this.length(), ring = this.ring();
    const square = [[0.3, 0, 0], [0.3, 0.3, 0], [0, 0.3, 0]].map((c) => add(p, scaled(c, length)));
    return [...AXES.map(({ along, colour }) => [p, add(p, scaled(along, length)), colour, 7]),
      ...ring.slice(1).map((q, i) => [ring[i], q, TURN.colour, 4]), [square[0], square[1], PLANE.colour, 4], [square[1], square[2], PLANE.colour, 4]];
  }

  /** The handle at a place of the canvas, if any. */
  at(place, kind) {
    if (!this.pose()) return null;
    const { view } = this, p = this.pose().slice(0, 3), length = this.length();
    const away = (points) => least(points.map((q) => view.project(q)).filter(Boolean).map((q) => Math.hypot(q[0] - place[0], q[1] - place[1])));
    const shares = Array.from({ length: 25 }, (_, i) => i / 24);
    const along = (a, b) => shares.map((s) => add(scaled(a, 1 - s), scaled(b, s)));
    const corner = add(p, scaled([0.3, 0.3, 0], length)), ring = this.ring();
    const all = [
      ...AXES.map((axis) => [away(along(add(p, scaled(axis.along, 0.35 * length)), add(p, scaled(axis.along, length)))), axis]),
      [away([p, corner, ...along(add(p, scaled([0.3, 0, 0], length)), corner), ...along(add(p, scaled([0, 0.3, 0], length)), corner)]), PLANE],
      [away(ring.slice(1).flatMap((q, i) => along(ring[i], q).filter((_, k) => k % 6 === 0))), TURN],
    ].sort((a, b) => a[0] - b[0]);
    return all[0][0] <= (NEAR_HANDLE[kind] || NEAR_HANDLE.mouse) ? all[0][1] : null;
  }

  /** A function from a place of the pointer to the pose of the submap, after a handle was taken at `from`. */
  taken(handle, from) {
    const { view } = this, pose = [...this.pose()], p = pose.slice(0, 3), length = this.length();
    const shifted = (d) => [...add(p, d), ...pose.slice(3)];
    if (handle.along) {
      const [a, b] = [view.project(p), view.project(add(p, scaled(handle.along, length)))], v = sub(b, a);
      return (to) => shifted(scaled(handle.along, (length * dot(sub(to, from), v)) / Math.max(dot(v, v), 1)));
    }
    const start = view.onPlane(...from, p[2]);
    if (!start) return () => pose;
    const angle = (q) => Math.atan2(q[1] - p[1], q[0] - p[0]);
    return (to) => {
      const now = view.onPlane(...to, p[2]);
      if (!now) return pose;
      return handle === PLANE ? shifted(sub(now, start)) : turnedPose(pose, angle(now) - angle(start));
    };
  }
}

/** A pose turned about the vertical through its position, radians. */
function turnedPose(pose, angle) {
  return [...pose.slice(0, 3), ...turnedBy([0, 0, Math.sin(angle / 2), Math.cos(angle / 2)], pose.slice(3))];
}
