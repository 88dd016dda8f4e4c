"""Archives whose bytes depend on nothing but their content and one time stamp: tar, gzip, and Debian packages."""

import gzip
import hashlib
import io
import lzma
import tarfile
from pathlib import PurePosixPath


def gzipped(content):
    return gzip.compress(content, compresslevel=9, mtime=0)


def tar(files, time, prefix=""):
    """A tar file of `files`, from paths to (content, mode); folders come before what is in them. All of it belongs to root and is as old as `time`; names begin with `prefix`."""
    folders = {str(parent) for path in files for parent in PurePosixPath(path).parents if str(parent) != "."}
    result = io.BytesIO()
    with tarfile.open(fileobj=result, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for path in sorted(folders | set(files)):
            entry = tarfile.TarInfo(prefix + path)
            entry.mtime, entry.uname, entry.gname = time, "root", "root"
            if path in folders:
                entry.type, entry.mode = tarfile.DIRTYPE, 0o755
                archive.addfile(entry)
            else:
                content, entry.mode = files[path]
                entry.size = len(content)
                archive.addfile(entry, io.BytesIO(content))
    return result.getvalue()


def deb(control, files, scripts, time):
    """A Debian package: `control` without its size, files by their path below the root, and the scripts of maintainers by name."""
    size = sum(-(-len(content) // 1024) for content, _ in files.values())
    sums = "".join(f"{hashlib.md5(content, usedforsecurity=False).hexdigest()}  {path}\n" for path, (content, _) in sorted(files.items()))
    about = {"control": (f"{control}Installed-Size: {size}\n".encode(), 0o644), "md5sums": (sums.encode(), 0o644)}
    about |= {name: (text.encode(), 0o755) for name, text in scripts.items()}
    conffiles = "".join(f"/{path}\n" for path in sorted(files) if path.startswith("etc/"))
    if conffiles:
        about["conffiles"] = (conffiles.encode(), 0o644)
    data = lzma.compress(tar(files, time, "./"), preset=9)
    return ar([("debian-binary", b"2.0\n"), ("control.tar.gz", gzipped(tar(about, time, "./"))), ("data.tar.xz", data)], time)


def ar(members, time):
    """The archive format of `ar`, as dpkg reads it."""
    result = b"!<arch>\n"
    for name, content in members:
        result += f"{name:<16}{time:<12}{0:<6}{0:<6}{100644:<8}{len(content):<10}`\n".encode() + content + b"\n" * (len(content) % 2)
    return result
