"""What a release is made of: the crates that are in it, their licences, and the order in which our own are published."""

import json
import re
import subprocess
import time
from pathlib import Path

LICENCE_FILE = re.compile(r"(?i)^(licen[cs]e|copying|copyright|notice|unlicense)")


def licence(package):
    return " ".join((package["license"] or "").split())


class Inventory:
    """The crates that the wheel is linked from, with ROS 2, for one target."""

    def __init__(self, root, target):
        command = ["cargo", "metadata", "--locked", "--format-version", "1", "--filter-platform", target, "--features", "voxelastic-cli/ros2"]
        listed = json.loads(subprocess.run(command, cwd=root, check=True, capture_output=True, text=True).stdout)
        self.packages = {package["id"]: package for package in listed["packages"]}
        self.members = [self.packages[member] for member in listed["workspace_members"]]
        needs = {node["id"]: [d["pkg"] for d in node["deps"] if any(kind["kind"] is None for kind in d["dep_kinds"])] for node in listed["resolve"]["nodes"]}
        self.version = self.member("voxelastic")["version"]
        todo, self.needs = [self.member("voxelastic-python")["id"]], {}
        while todo:
            package = todo.pop()
            if package not in self.needs:
                self.needs[package] = sorted(needs[package])
                todo += needs[package]
        self.linked = sorted((self.packages[i] for i in self.needs), key=lambda p: (p["name"], p["version"]))
        lock = (root / "Cargo.lock").read_text(encoding="utf-8")
        self.hashes = {(n, v): h for n, v, h in re.findall(r'name = "(.+)"\nversion = "(.+)"\nsource = ".+"\nchecksum = "(.+)"', lock)}

    def member(self, name):
        return next(package for package in self.members if package["name"] == name)

    def publishing_order(self):
        """Our crates that crates.io gets, each after those that it needs; for tests, too, unless only a path says where they are: that is left out there."""
        names = {p["name"]: p for p in self.members if p["publish"] != []}
        needs = {n: {d["name"] for d in p["dependencies"] if d["name"] in names and d["req"] != "*"} for n, p in names.items()}
        order = []
        while len(order) < len(names):
            ready = [n for n in names if n not in order and needs[n] <= set(order)]
            if not ready:
                raise SystemExit("error: the crates need each other in a circle")
            order += sorted(ready)
        return order

    def third_parties(self):
        """The texts of the licences of what is linked, each text once, with the crates that it holds for."""
        texts, without = {}, []
        for package in self.linked:
            if package["source"] is None:
                continue
            name = f"{package['name']} {package['version']} ({licence(package) or 'see its files'})"
            files = sorted(f for f in Path(package["manifest_path"]).parent.iterdir() if f.is_file() and LICENCE_FILE.match(f.name))
            if not files:
                without.append(name)
            for file in files:
                text = "\n".join(line.rstrip() for line in file.read_text(encoding="utf-8", errors="replace").strip().splitlines())
                texts.setdefault(text, []).append(name)
        parts = [f"{'=' * 80}\n" + "\n".join(names) + f"\n{'=' * 80}\n\n{text}\n" for text, names in sorted(texts.items(), key=lambda item: item[1])]
        head = "What the program voxelastic contains of others, and under which licences.\n\nWithout a text of its own, under the licence that is named:\n\n"
        return head + "".join(f"  {name}\n" for name in without) + "\n" + "\n".join(parts)

    def sbom(self, built_at):
        """A bill of materials: CycloneDX 1.5, without what differs from build to build."""
        reference = {i: f"pkg:cargo/{self.packages[i]['name']}@{self.packages[i]['version']}" for i in self.needs}
        components = []
        for package in self.linked:
            entry = {"type": "library", "bom-ref": reference[package["id"]], "name": package["name"], "version": package["version"], "purl": reference[package["id"]]}
            if licence(package):
                entry["licenses"] = [{"expression": licence(package).replace("/", " OR ")}]
            if checksum := self.hashes.get((package["name"], package["version"])):
                entry["hashes"] = [{"alg": "SHA-256", "content": checksum}]
            components.append(entry)
        this = {"type": "application", "bom-ref": "voxelastic", "name": "voxelastic", "version": self.version}
        return {
            "bomFormat": "CycloneDX",
            "specVersion": "1.5",
            "version": 1,
            "metadata": {"timestamp": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(built_at)), "component": this},
            "components": components,
            "dependencies": [{"ref": reference[i], "dependsOn": [reference[n] for n in needs]} for i, needs in sorted(self.needs.items())],
        }
