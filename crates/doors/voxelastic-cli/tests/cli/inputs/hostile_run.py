"""usage: hostile_run.py FOLDER COMMAND MAP: runs the command on every file of hostile_files.py, which it puts into the folder, one after the other.

Prints what ended otherwise than by an exit code of the command, was too slow, took too much memory, or acts on a terminal; and the number of files.
"""

import os
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import hostile_files

SECONDS, MEGABYTES = 60, 512


def limit():
    """What goes wrong does not take the machine with it."""
    resource.setrlimit(resource.RLIMIT_AS, (8 * MEGABYTES << 20,) * 2)


def run(arguments, folder):
    """Exit code or signal, what was said, seconds, megabytes at the peak."""
    begin = time.monotonic()
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(arguments, cwd=folder, stdin=subprocess.DEVNULL, stdout=said, stderr=said, preexec_fn=limit)
        timer = threading.Timer(SECONDS, process.kill)
        timer.start()
        _, status, usage = os.wait4(process.pid, 0)
        timer.cancel()
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        return process.returncode, said.read(), time.monotonic() - begin, usage.ru_maxrss / 1024


def main():
    folder, command, good = map(Path, sys.argv[1:4])
    count, peak, slowest = 0, (0, ""), (0, "")
    codes = {}
    for name, files, arguments in hostile_files.all_cases():
        data = folder / "data"
        for path, content in files.items():
            (data / path).parent.mkdir(parents=True, exist_ok=True)
            (data / path).write_bytes(content)
        words = arguments.format(data=data, good=good, out=folder / "out").split(" ")
        code, said, seconds, megabytes = run([str(command), *words], folder)
        wrong = [] if code in (0, 1, 2, 3) else [f"ended with {code}"]
        wrong += ["panicked"] if b"panicked" in said or b"has a bug" in said else []
        wrong += ["acts on the terminal"] if any(byte in said for byte in (b"\x1b", b"\x07", b"\xc2\x9b")) else []
        wrong += [f"took {megabytes:.0f} MB"] if megabytes > MEGABYTES else []
        wrong += [f"took {seconds:.0f} s"] if seconds > SECONDS / 2 else []
        if wrong:
            print(f"{name}: {', '.join(wrong)}: {said[-600:].decode(errors='replace')!a}", flush=True)
        count, codes[code] = count + 1, codes.get(code, 0) + 1
        peak, slowest = max(peak, (megabytes, name)), max(slowest, (seconds, name))
        shutil.rmtree(data)
        for path in folder.glob("out*"):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    print(f"{count} files, exit codes {codes}, at most {peak[0]:.0f} MB ({peak[1]}) and {slowest[0]:.1f} s ({slowest[1]})")


if __name__ == "__main__":
    main()
