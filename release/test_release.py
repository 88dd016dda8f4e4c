"""Tests of release/build that build nothing: python3 -m unittest discover release"""

import base64
import gzip
import hashlib
import importlib.machinery
import importlib.util
import io
import lzma
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import unittest
import zipfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.dont_write_bytecode = True
sys.path.insert(0, str(HERE))
import archives  # noqa: E402
from inventory import Inventory  # noqa: E402

_spec = importlib.util.spec_from_loader("build", importlib.machinery.SourceFileLoader("build", str(HERE / "build")))
build = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(build)

FILES = {"usr/bin/tool": (b"#!/bin/sh\necho works\n", 0o755), "usr/share/doc/tool/README": (b"read me\n", 0o644), "etc/default/tool": (b"#A=1\n", 0o644)}
CONTROL = (HERE / "files" / "control").read_text().format(version="0.1.0", architecture="all", glibc="2.28")


class Archives(unittest.TestCase):
    def test_a_debian_package_has_its_files_whatever_their_order(self):
        package = archives.deb(CONTROL, FILES, {}, 1_700_000_000)
        self.assertEqual(package, archives.deb(CONTROL, dict(reversed(FILES.items())), {}, 1_700_000_000))
        self.assertTrue(package.startswith(b"!<arch>\ndebian-binary"))
        data = package[package.index(b"\xfd7zXZ") :]
        with tarfile.open(fileobj=io.BytesIO(lzma.decompress(data))) as archive:
            found = {m.name.removeprefix("./"): (archive.extractfile(m).read(), m.mode) for m in archive if m.isfile()}
            self.assertEqual({(m.uname, m.gname, m.mtime) for m in archive}, {("root", "root", 1_700_000_000)})
            names = archive.getnames()
        self.assertEqual(found, FILES)
        # dpkg makes no folder by itself.
        for name in names:
            parent = name.rpartition("/")[0]
            self.assertIn(parent, [".", *names[: names.index(name)]])

    @unittest.skipUnless(shutil.which("dpkg-deb"), "needs dpkg-deb")
    def test_dpkg_reads_it(self):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "tool.deb"
            path.write_bytes(archives.deb(CONTROL, FILES, {"postinst": "#!/bin/sh\nexit 0\n"}, 1_700_000_000))
            fields = subprocess.run(["dpkg-deb", "--field", path], check=True, capture_output=True, text=True).stdout
            self.assertIn("Depends: libc6 (>= 2.28)", fields)
            self.assertIn("Installed-Size: 3\n", fields)
            subprocess.run(["dpkg-deb", "--raw-extract", path, Path(folder) / "raw"], check=True)
            self.assertEqual((Path(folder) / "raw/DEBIAN/conffiles").read_text(), "/etc/default/tool\n")
            self.assertEqual(subprocess.run([Path(folder) / "raw/usr/bin/tool"], capture_output=True, text=True).stdout, "works\n")
            subprocess.run(["md5sum", "--check", "--quiet", "DEBIAN/md5sums"], cwd=Path(folder) / "raw", check=True)

    def test_a_wheel_with_licences_has_a_true_record(self):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "a.whl"
            with zipfile.ZipFile(path, "w") as wheel:
                wheel.writestr(zipfile.ZipInfo("a/__init__.py", (2026, 1, 2, 3, 4, 6)), "x = 1\n")
                wheel.writestr(zipfile.ZipInfo("a-1.dist-info/RECORD", (2026, 1, 2, 3, 4, 6)), "a/__init__.py,sha256=wrong,6\n")
            content = build.with_licences(path, {"MIT": "Free, with “quotes”\n"})
            self.assertEqual(content, build.with_licences(path, {"MIT": "Free, with “quotes”\n"}))
        with zipfile.ZipFile(io.BytesIO(content)) as wheel:
            rows = [line.split(",") for line in wheel.read("a-1.dist-info/RECORD").decode().splitlines()]
            self.assertEqual([row[0] for row in rows], wheel.namelist())
            for name, digest, size in rows[:-1]:
                expected = base64.urlsafe_b64encode(hashlib.sha256(wheel.read(name)).digest()).rstrip(b"=").decode()
                self.assertEqual((digest, int(size)), (f"sha256={expected}", len(wheel.read(name))))


class Contents(unittest.TestCase):
    def test_what_is_packaged_is_there_and_goes_where_it_belongs(self):
        self.assertEqual(build.problems(), [])
        paths = [path for path, _ in build.CONTENTS]
        self.assertEqual(len(paths), len(set(paths)))
        for path in ["bin/voxelastic", "share/man/man1/", "lib/systemd/system/voxelastic.service", "share/doc/voxelastic/LICENSE-MIT"]:
            self.assertIn(path, paths)

    def test_another_version_somewhere_is_found(self):
        read = build.read
        try:
            build.read = lambda path: read(path).replace("version: 0.1.0", "version: 0.0.9") if path == "CITATION.cff" else read(path)
            (problem,) = build.problems()
            self.assertRegex(problem, r"^CITATION\.cff: says 0\.0\.9 where Cargo\.toml says ")
            build.read = lambda path: "# Changelog\n" if path == "CHANGELOG.md" else read(path)
            (problem,) = build.problems()
            self.assertIn("CHANGELOG.md: has no entry", problem)
        finally:
            build.read = read


@unittest.skipUnless(shutil.which("cargo"), "needs cargo")
class Lists(unittest.TestCase):
    inventory = Inventory(HERE.parent, "x86_64-unknown-linux-gnu") if shutil.which("cargo") else None

    def test_crates_are_published_after_those_that_they_need(self):
        order = self.inventory.publishing_order()
        self.assertEqual(order[0], "voxelastic")
        self.assertEqual(order[-1], "voxelastic-cli")
        self.assertNotIn("voxelastic-python", order)
        for package in (self.inventory.member(name) for name in order):
            for need in package["dependencies"]:
                if need["name"] in order and need["req"] != "*":
                    self.assertLess(order.index(need["name"]), order.index(package["name"]))

    def test_the_bill_names_what_is_linked_with_licence_and_hash(self):
        bill = self.inventory.sbom(1_700_000_000)
        parts = {part["name"]: part for part in bill["components"]}
        self.assertEqual(bill["metadata"]["timestamp"], "2023-11-14T22:13:20Z")
        for name in ["zenoh", "rustdds", "zstd-sys", "pyo3", "voxelastic"]:
            self.assertIn(name, parts)
        self.assertNotIn("proptest", parts)
        for part in bill["components"]:
            if not part["name"].startswith("voxelastic"):
                self.assertRegex(part["hashes"][0]["content"], "^[0-9a-f]{64}$")
                self.assertTrue(part["licenses"][0]["expression"].strip(), part["name"])
        known = {part["bom-ref"] for part in bill["components"]}
        for entry in bill["dependencies"]:
            self.assertLessEqual({entry["ref"], *entry["dependsOn"]}, known)

    def test_licences_of_others_are_kept_once_each(self):
        text = self.inventory.third_parties()
        self.assertIn("  ros2-client ", text)
        self.assertEqual(gzip.decompress(archives.gzipped(text.encode())).decode(), text)
        bodies = re.split(r"^={80}\n(?:.+\n)+={80}\n", text, flags=re.M)[1:]
        self.assertEqual(len(bodies), len({body.strip() for body in bodies}))


if __name__ == "__main__":
    unittest.main()
