// How long a page that is attached to a viewer's server takes until it shows the whole map, and how long it takes to draw. Three things apart: what came over the
// wire and when all of it was in the page (`received_ms`), how long the page was busy with it (`busy_ms`: unpacking, levels of detail, handing it to the graphics
// card), and when the first picture of all of it was finished (`whole_picture_ms`; of that alone `whole_picture_took_ms`).
//
//     node --experimental-websocket attach.mjs http://127.0.0.1:7717 [picture.png]
//
// Needs Chromium, headless, which draws without a graphics card if there is none: then drawing is slow. Times are milliseconds since the page was asked for.
import { spawn } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";

const [url, picture] = process.argv.slice(2);
const pause = (ms) => new Promise((done) => setTimeout(done, ms));
const profile = mkdtempSync(join(tmpdir(), "attach-"));
const flags = ["--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--no-first-run", "--disable-background-networking",
  "--disable-dev-shm-usage", "--remote-debugging-port=0", "--window-size=1600,1000", `--user-data-dir=${profile}`, "about:blank"];
const browser = spawn("chromium", flags, { stdio: "ignore" });

/** In the page: what there is every 5 ms, and when each picture began and was finished. */
const WATCH = `
window.log = { seen: [], pictures: [] };
const watching = setInterval(() => {
  const it = window.voxelastic;
  if (!it) return;
  if (!it.wrapped) {
    it.wrapped = true;
    const { view } = it, render = view.render.bind(view);
    view.render = (fine) => {
      const begin = performance.now();
      if (view.unfinished) return render(fine);
      render(fine);
      // The call returns while the picture is still being drawn, and finish() does not wait in Chromium.
      const { gl } = view, fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0), row = [begin, 0, view.triangles, fine ? 1 : 0, view.drawn?.triangles];
      gl.flush();
      const look = () => {
        if (gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED) return setTimeout(look, 2);
        row[1] = performance.now();
        log.pictures.push(row);
      };
      setTimeout(look, 0);
    };
  }
  log.seen.push([performance.now(), it.view.triangles, it.seen.bytes]);
}, 5);`;

try {
  let port;
  for (let k = 0; k < 300 && !port; k++) {
    await pause(100);
    try { port = readFileSync(join(profile, "DevToolsActivePort"), "utf8").split("\n")[0]; } catch { /* not yet */ }
  }
  const [page] = (await (await fetch(`http://127.0.0.1:${port}/json/list`)).json()).filter((target) => target.type === "page");
  const socket = new WebSocket(page.webSocketDebuggerUrl);
  await new Promise((done) => (socket.onopen = done));
  const waiting = new Map();
  socket.onmessage = ({ data }) => {
    const { id, result, error } = JSON.parse(data);
    waiting.get(id)?.(error ? { error } : result);
  };
  let calls = 0;
  const call = (method, params = {}) => new Promise((done) => {
    waiting.set(++calls, done);
    socket.send(JSON.stringify({ id: calls, method, params }));
  });
  const value = async (expression) => (await call("Runtime.evaluate", { expression, returnByValue: true, awaitPromise: true })).result?.value;
  await call("Page.enable");
  await call("Page.addScriptToEvaluateOnNewDocument", { source: WATCH });
  await call("Page.navigate", { url });
  // Until nothing has come for three seconds.
  for (let last = -1, since = Date.now(); Date.now() - since < 3000 || last <= 0;) {
    await pause(200);
    const bytes = await value("window.voxelastic ? voxelastic.seen.bytes : 0");
    if (bytes !== last) [last, since] = [bytes, Date.now()];
  }
  const messages = await value("({ count: voxelastic.seen.messages, busy: voxelastic.seen.busy, tiles: voxelastic.view.tiles.size })");
  const { seen, pictures } = JSON.parse(await value("JSON.stringify(log)"));
  const [, triangles, bytes] = seen.at(-1);
  const all = seen.find((row) => row[1] === triangles && row[2] === bytes)[0];
  const whole = pictures.find((row) => row[2] === triangles);
  const first = pictures.find((row) => row[2] > 0);
  // Then it is turned, as by somebody who looks at it.
  const turned = await value(`(async () => {
    const { view } = voxelastic, took = [];
    const pause = (ms) => new Promise((done) => setTimeout(done, ms));
    view.follow = false;
    view.reset(true);
    await pause(1000);
    const free = async () => { while (view.unfinished) await pause(1); };
    for (let k = 0; k < 20; k++) {
      await free();
      const begin = performance.now(), before = log.pictures.length;
      view.camera.yaw += 0.1;
      view.render(false);
      while (log.pictures.length === before) await pause(1);
      took.push(performance.now() - begin);
    }
    return JSON.stringify(took.sort((a, b) => a - b));
  })()`);
  const took = JSON.parse(turned);
  const renderer = await value(`(() => { const { gl } = voxelastic.view, info = gl.getExtension("WEBGL_debug_renderer_info"); return info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : "unknown"; })()`);
  console.log(JSON.stringify({
    renderer, triangles, tiles: messages.tiles, messages: messages.count, megabytes: bytes / 1e6, first_picture_ms: first?.[1], received_ms: all, busy_ms: messages.busy,
    whole_picture_ms: whole?.[1], whole_picture_took_ms: whole && whole[1] - whole[0], whole_picture_triangles: whole?.[4], pictures_until_then: pictures.indexOf(whole) + 1,
    fine_picture_begin_end_ms: pictures.filter((row) => row[3]).at(-1)?.map(Math.round).slice(0, 2), drawing_ms: { median: took[10], most: took[19] },
  }));
  if (picture) {
    await value(`voxelastic.view.follow = false, voxelastic.view.reset(true), 1`);
    await pause(3000);
    const { data } = await call("Page.captureScreenshot", { format: "png" });
    writeFileSync(picture, Buffer.from(data, "base64"));
  }
  socket.close();
} finally {
  browser.kill();
  await pause(500);
  rmSync(profile, { recursive: true, force: true });
}
