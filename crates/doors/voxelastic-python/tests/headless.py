"""A headless browser for tests of what is shown in one."""

from __future__ import annotations

import http.server
import json
import os
import queue
import shutil
import subprocess
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage"),
)
PATIENCE_S = 300.0
"""A busy machine without a graphics card is slow."""
KINDS = {".html": "text/html", ".js": "text/javascript", ".json": "application/json"}


def seen(files: Mapping[str, bytes], profile: Path, page: str = "page.html") -> Any:
    """Serves these files, opens the page, and returns the JSON that it posts to `/seen`. Skips the test without a browser, unless `VOXELASTIC_REQUIRE` lists it."""
    browser = next(filter(None, map(shutil.which, NAMES)), None)
    if browser is None:
        if "browser" in os.environ.get("VOXELASTIC_REQUIRE", ""):
            pytest.fail("neither chromium nor google-chrome is installed, and VOXELASTIC_REQUIRE lists browser")
        pytest.skip("neither chromium nor google-chrome is installed")
    posted: queue.Queue[Any] = queue.Queue()

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:  # noqa: N802
            name = self.path.lstrip("/")
            self.send_response(200 if name in files else 404)
            self.send_header("Content-Type", KINDS.get(Path(name).suffix, "application/octet-stream"))
            self.end_headers()
            self.wfile.write(files.get(name, b""))

        def do_POST(self) -> None:  # noqa: N802
            posted.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(204)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_address[1]}/{page}"
        words = [browser, *FLAGS, "--window-size=900,700", f"--user-data-dir={profile}", url]
        with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            try:
                return posted.get(timeout=PATIENCE_S)
            except queue.Empty:
                pytest.fail(f"the page posted nothing within {PATIENCE_S:.0f} s")
            finally:
                process.kill()
                server.shutdown()
