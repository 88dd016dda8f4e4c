#!/usr/bin/env python3
"""Measures the page of tiles in a headless Chromium: the time to the first picture, memory, frames a second.

    python3 crates/parts/voxelastic-report/page/tiles/measure.py tiles/            a folder that `voxelastic export MAP -o tiles/` has written
    python3 crates/parts/voxelastic-report/page/tiles/measure.py tiles/ --picture page.png

The folder is served over loopback by this program. The page is looked at as it opens (the whole map), then the camera goes once around the middle of the map, low above it, then it
stands there until all tiles are loaded. Prints JSON:

    first_picture_s   from the start of the navigation to the first frame with a tile
    complete_s        until all tiles of the opened page are loaded
    flight            frames a second on the way, longest frame in s, requests and MB of tiles loaded until its end
    standing          tiles shown, triangles, frames a second after it, where nothing is loaded
    browser_mb        largest memory of all processes of the browser together (proportional set size), and of it that of the process of the page
    problems          what the page says is wrong

Needs Python 3 and Chromium, on Linux. Without a graphics card Chromium draws in software (SwiftShader).
"""

from __future__ import annotations

import argparse
import base64
import http.server
import json
import os
import queue
import shutil
import subprocess
import tempfile
import threading
import time
from pathlib import Path

FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--no-first-run", "--disable-background-networking", "--disable-component-update"]

DRIVER = """
const until = async (what) => { while (!what()) await new Promise((done) => setTimeout(done, 20)); };
const frames = async (seconds, each) => {
  const begun = performance.now();
  let [last, count, longest] = [begun, 0, 0];
  await new Promise((done) => {
    const frame = (now) => {
      [longest, last, count] = [Math.max(longest, now - last), now, count + 1];
      each?.((now - begun) / (1000 * seconds));
      if (now - begun < 1000 * seconds) requestAnimationFrame(frame); else done();
    };
    requestAnimationFrame(frame);
  });
  return { seconds, frames_per_second: Math.round(10 * count / ((performance.now() - begun) / 1000)) / 10, longest_frame_s: Math.round(longest) / 1000 };
};
const loaded = () => performance.getEntriesByType('resource').filter((entry) => /\\.(glb|json)$/.test(entry.name));
const rounded = (ms) => Math.round(ms) / 1000;
performance.setResourceTimingBufferSize(100000);
(async () => {
  await until(() => window.voxelastic?.firstPictureMs);
  const page = window.voxelastic, seen = { first_picture_s: rounded(page.firstPictureMs) };
  await until(() => page.ready);
  seen.complete_s = rounded(performance.now());
  seen.opened = { tiles: page.shown, triangles: page.renderer.info.render.triangles, megabytes: page.bytes / 1e6 };
  const [low, high] = BOX;
  const middle = low.map((c, k) => (c + high[k]) / 2), radius = 0.25 * (high[0] - low[0]);
  const fly = (share) => {
    const turn = 2 * Math.PI * share;
    page.camera.position.set(middle[0] + radius * Math.cos(turn), middle[1] + radius * Math.sin(turn), high[2] + 15);
    page.camera.lookAt(middle[0] + 0.6 * radius * Math.cos(turn + 0.6), middle[1] + 0.6 * radius * Math.sin(turn + 0.6), low[2]);
    page.camera.near = 0.3;
    page.camera.updateProjectionMatrix();
  };
  seen.flight = await frames(20, fly);
  Object.assign(seen.flight, { requests: loaded().length, megabytes: Math.round(loaded().reduce((sum, entry) => sum + entry.encodedBodySize, 0) / 1e5) / 10 });
  await until(() => page.ready);
  seen.standing = await frames(5);
  Object.assign(seen.standing, { tiles: page.shown, triangles: page.renderer.info.render.triangles });
  seen.cached_megabytes = Math.round(page.bytes / 1e5) / 10;
  seen.picture = await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(page.renderer.domElement.toDataURL('image/png')))));
  seen.problems = page.problems;
  await fetch('/said', { method: 'POST', body: JSON.stringify(seen) });
})().catch((error) => fetch('/said', { method: 'POST', body: JSON.stringify({ problems: [String(error.stack)] }) }));
"""


def box(folder: Path) -> list[list[float]]:
    """Lowest and highest corner of the map."""
    root = json.loads((folder / "tileset.json").read_text())["root"]
    volume, move_by = root["boundingVolume"]["box"], root.get("transform", [0.0] * 16)[12:15]
    return [[volume[k] + move_by[k] + side * volume[3 + 4 * k] for k in range(3)] for side in (-1, 1)]


def memory(process: int) -> tuple[float, float]:
    """Proportional set size of a process and all below it, MB; and of the largest one that draws a page."""
    parents: dict[int, int] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parents[int(entry.name)] = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
            except OSError:
                continue
    ours = {process}
    while found := {child for child, parent in parents.items() if parent in ours and child not in ours}:
        ours |= found
    total = page = 0.0
    for one in ours:
        try:
            line = next(line for line in Path(f"/proc/{one}/smaps_rollup").read_text().splitlines() if line.startswith("Pss:"))
            command = Path(f"/proc/{one}/cmdline").read_bytes()
        except (OSError, StopIteration):
            continue
        megabytes = int(line.split()[1]) * 1024 / 1e6
        total += megabytes
        if b"--type=renderer" in command:
            page = max(page, megabytes)
    return total, page


def main() -> None:
    """Runs the measurement."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tiles", type=Path)
    parser.add_argument("--picture", type=Path, help="file for the picture at the end, PNG")
    parser.add_argument("--size", default="1280,800", help="size of the window, pixels [default: 1280,800]")
    given = parser.parse_args()
    said: queue.Queue[bytes] = queue.Queue()
    driver = DRIVER.replace("BOX", json.dumps(box(given.tiles)))
    page = (given.tiles / "index.html").read_text().replace("<script", f"<script>{driver}</script><script", 1).encode()

    class Handler(http.server.SimpleHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def __init__(self, *arguments: object) -> None:
            super().__init__(*arguments, directory=str(given.tiles))  # type: ignore[arg-type]

        def do_GET(self) -> None:
            if self.path != "/":
                return super().do_GET()
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.send_header("Content-Length", str(len(page)))
            self.end_headers()
            self.wfile.write(page)

        def do_POST(self) -> None:
            said.put(self.rfile.read(int(self.headers["Content-Length"])))
            self.send_response(204)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    browser = next((found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None)
    if browser is None:
        raise SystemExit("neither chromium nor google-chrome is installed")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        address = f"http://127.0.0.1:{server.server_address[1]}/"
        command = [browser, *FLAGS, f"--window-size={given.size}", f"--user-data-dir={profile}", address]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        most, begun, answer = (0.0, 0.0), time.monotonic(), None
        try:
            while answer is None and time.monotonic() - begun < 300:
                now = memory(process.pid)
                most = (max(most[0], now[0]), max(most[1], now[1]))
                try:
                    answer = json.loads(said.get(timeout=0.25))
                except queue.Empty:
                    continue
        finally:
            process.kill()
            process.wait()
    if answer is None:
        raise SystemExit("the page says nothing")
    picture = answer.pop("picture", None)
    if given.picture is not None and picture is not None:
        given.picture.write_bytes(base64.b64decode(picture.split(",", 1)[1]))
    answer["browser_mb"] = {"all": round(most[0]), "page": round(most[1])}
    answer["tiles_mb"] = round(sum(path.stat().st_size for path in given.tiles.rglob("*") if path.is_file()) / 1e6, 1)
    answer["cores"] = len(os.sched_getaffinity(0))
    print(json.dumps(answer, indent=1))


if __name__ == "__main__":
    main()
