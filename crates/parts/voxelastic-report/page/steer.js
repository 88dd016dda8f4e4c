// What the reader does to a picture in 3D: pointer, wheel, keys.

/** Turns, moves and zooms `view` as the pointer, the wheel and the keys say. */
function steer(view) {
  const { canvas } = view;
  const fingers = new Map();
  let gesture = null;
  const clampPitch = (p) => Math.min(Math.max(p, -1.5), 1.5707);
  const orbit = (dx, dy) => {
    view.flight = null;
    view.camera.yaw -= dx * 0.006;
    view.camera.pitch = clampPitch(view.camera.pitch + dy * 0.006);
    view.draw();
  };
  const pan = (dx, dy) => {
    view.flight = null;
    const [across, up] = view.axes();
    // Along the ground: pushing the map away moves it away, however flat the view is.
    const { yaw, pitch } = view.camera;
    const ahead = pitch > 0.3 ? scaled([-Math.cos(yaw), -Math.sin(yaw), 0], 1 / Math.max(Math.sin(pitch), 0.35)) : up;
    const m = view.metresPerPixel();
    view.camera.target = add(view.camera.target, add(scaled(across, -dx * m), scaled(ahead, dy * m)));
    view.draw();
  };
  const zoom = (factor, x, y) => {
    view.flight = null;
    const { camera } = view;
    const distance = Math.min(Math.max(camera.distance * factor, 0.4), view.farthest * 3 || 1e4);
    if (x !== undefined) {
      // What is under the pointer stays there.
      const [across, up] = view.axes();
      const m = view.metresPerPixel() * (1 - distance / camera.distance);
      const shift = add(scaled(across, (x - canvas.clientWidth / 2) * m), scaled(up, -(y - canvas.clientHeight / 2) * m));
      camera.target = add(camera.target, shift);
    }
    camera.distance = distance;
    view.draw();
  };
  const place = (e) => {
    const box = canvas.getBoundingClientRect();
    return [e.clientX - box.left, e.clientY - box.top];
  };

  canvas.addEventListener("pointerdown", (e) => {
    try { canvas.setPointerCapture(e.pointerId); } catch { /* A pointer that a test made up. */ }
    canvas.focus({ preventScroll: true });
    fingers.set(e.pointerId, place(e));
    gesture = e.button === 2 || e.button === 1 || e.shiftKey ? "pan" : "orbit";
    e.preventDefault();
  });
  canvas.addEventListener("pointermove", (e) => {
    const before = fingers.get(e.pointerId);
    if (!before) return;
    const now = place(e);
    if (fingers.size === 2) {
      const other = [...fingers].find(([id]) => id !== e.pointerId)[1];
      const apart = (p) => Math.max(Math.hypot(p[0] - other[0], p[1] - other[1]), 20);
      zoom(apart(before) / apart(now), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
      pan((now[0] - before[0]) / 2, (now[1] - before[1]) / 2);
    } else if (fingers.size === 1) {
      (gesture === "pan" ? pan : orbit)(now[0] - before[0], now[1] - before[1]);
    }
    fingers.set(e.pointerId, now);
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (e) => fingers.delete(e.pointerId));
  canvas.addEventListener("contextmenu", (e) => e.preventDefault());
  canvas.addEventListener("dblclick", (e) => {
    const point = view.pick(...place(e));
    if (point) view.fly({ ...view.camera, target: point, distance: Math.min(view.camera.distance, Math.hypot(...sub(point, view.eye())) * 0.5) });
  });
  // The wheel scrolls the page until the map was clicked.
  canvas.addEventListener("wheel", (e) => {
    if (document.activeElement !== canvas && !e.ctrlKey) return;
    e.preventDefault();
    zoom(Math.exp(Math.max(-1, Math.min(1, e.deltaY * (e.deltaMode ? 0.03 : 0.0012) * (e.ctrlKey ? 4 : 1)))), ...place(e));
  }, { passive: false });
  canvas.addEventListener("keydown", (e) => {
    if (e.ctrlKey || e.metaKey || e.altKey) return;
    const step = { ArrowLeft: [-24, 0], ArrowRight: [24, 0], ArrowUp: [0, -24], ArrowDown: [0, 24] }[e.key];
    const colour = Number(e.key) - 1;
    if (step) (e.shiftKey ? pan : orbit)(...step);
    else if (e.key === "+" || e.key === "=") zoom(0.85);
    else if (e.key === "-") zoom(1 / 0.85);
    else if (e.key === "r" || e.key === "R") view.reset();
    else if (e.key === "t" || e.key === "T") view.top();
    else if (e.key === "f" || e.key === "F") fillScreen();
    else if (colour in COLOURS) byId("panel").querySelector(`[data-mode="${colour}"]:not(:disabled)`)?.click();
    else return;
    e.preventDefault();
  });
}

function fillScreen() {
  if (document.fullscreenElement) document.exitFullscreen();
  else byId("stage").requestFullscreen?.().catch(() => {});
}
