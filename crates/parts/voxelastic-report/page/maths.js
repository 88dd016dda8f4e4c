// Vectors, quaternions (x y z w) and 4 x 4 matrices in column order, as WebGL wants them.

const add = (a, b) => a.map((v, i) => v + b[i]);
const sub = (a, b) => a.map((v, i) => v - b[i]);
const scaled = (a, s) => a.map((v) => v * s);
const dot = (a, b) => a.reduce((sum, v, i) => sum + v * b[i], 0);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => scaled(a, 1 / Math.max(Math.hypot(...a), 1e-12));

/** a * b. */
function product(a, b) {
  const m = new Float32Array(16);
  for (let c = 0; c < 4; c++)
    for (let r = 0; r < 4; r++) {
      let sum = 0;
      for (let k = 0; k < 4; k++) sum += a[k * 4 + r] * b[c * 4 + k];
      m[c * 4 + r] = sum;
    }
  return m;
}

/** Camera at `eye` that looks at `target`, `up` being up. */
function lookAt(eye, target, up) {
  const z = unit(sub(eye, target));
  const x = unit(cross(up, z));
  const y = cross(z, x);
  return [x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0, -dot(x, eye), -dot(y, eye), -dot(z, eye), 1];
}

/** Perspective with a vertical opening angle in radians. */
function perspective(angle, aspect, near, far) {
  const f = 1 / Math.tan(angle / 2);
  return [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0];
}

/** p turned by the quaternion q. */
function turned(q, p) {
  const t = scaled(cross(q, p), 2);
  return add(add(p, scaled(t, q[3])), cross(q, t));
}

/** A pose [x y z qx qy qz qw] on the way from a to b. */
function between(a, b, s) {
  const same = dot(a.slice(3), b.slice(3)) < 0 ? -1 : 1;
  const q = a.slice(3).map((v, i) => v * (1 - s) + same * b[i + 3] * s);
  return [...[0, 1, 2].map((i) => a[i] * (1 - s) + b[i] * s), ...unit(q)];
}

const moved = (pose, p) => add(turned(pose.slice(3), p), pose.slice(0, 3));
function movedBack(pose, p) {
  const [x, y, z, w] = pose.slice(3);
  return turned([-x, -y, -z, w], sub(p, pose.slice(0, 3)));
}

/** Matrix of: coordinates times `step`, plus `origin`, then the pose. */
function poseMatrix(pose, origin, step) {
  const columns = [[step, 0, 0], [0, step, 0], [0, 0, step]].map((c) => turned(pose.slice(3), c));
  const at = moved(pose, origin);
  return new Float32Array([...columns[0], 0, ...columns[1], 0, ...columns[2], 0, ...at, 1]);
}
