"""What a program or a library asks of the system that it runs on, from its ELF headers. Runs in the environment of release/requirements.txt.

    python release/symbols.py FILE    prints JSON: the libraries that it needs, and the newest version of glibc's symbols among those it uses
"""

import json
import sys

from elftools.elf.dynamic import DynamicSection
from elftools.elf.elffile import ELFFile
from elftools.elf.gnuversions import GNUVerNeedSection


def of(path):
    with open(path, "rb") as file:
        elf = ELFFile(file)
        dynamic = next(s for s in elf.iter_sections() if isinstance(s, DynamicSection))
        libraries = sorted(tag.needed for tag in dynamic.iter_tags("DT_NEEDED"))
        versions = set()
        for section in elf.iter_sections():
            if isinstance(section, GNUVerNeedSection):
                versions |= {entry.name for _, entries in section.iter_versions() for entry in entries}
        numbers = [tuple(map(int, name.removeprefix("GLIBC_").split("."))) for name in versions if name.startswith("GLIBC_")]
        return {"libraries": libraries, "glibc": ".".join(map(str, max(numbers))), "has_symbols": elf.get_section_by_name(".symtab") is not None}


if __name__ == "__main__":
    print(json.dumps(of(sys.argv[1])))
