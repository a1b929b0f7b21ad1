# SPDX-License-Identifier: GPL-3.0-or-later
"""python3 make_zip.py OUT.zip LIBVSHIFT_SO SCENES_STREET_DIR: the installable addon.

One zip serves Blender 3.4 (bl_info, folder vshift/) and 4.2 or newer (blender_manifest.toml): the files
lie in a folder vshift/. The same input gives the same bytes. Exit codes: 0, 3 bad input, 4 write failed.
"""
import os
import sys
import zipfile
from pathlib import Path

ADDON = Path(__file__).resolve().parent / "vshift"


def collect(library, street):
    """Sorted [(name in the zip, path)]."""
    out = [(f"vshift/{p.relative_to(ADDON).as_posix()}", p) for p in ADDON.rglob("*")
           if p.suffix in (".py", ".toml") and p.is_file()]
    out += [(f"vshift/scenes/street/{p.relative_to(street).as_posix()}", p) for p in street.rglob("*")
            if p.is_file() and p.suffix in (".py", ".json", ".npz", ".txt") and "__pycache__" not in p.parts]
    out.append(("vshift/lib/libvshift.so", library))
    return sorted(out)


def main(arguments):
    if len(arguments) != 3:
        print("make_zip.py: -: usage: got other arguments, expected OUT.zip LIBVSHIFT_SO SCENES_STREET_DIR", file=sys.stderr)
        return 3
    target, library, street = map(Path, arguments)
    for path, kind in ((library, Path.is_file), (street / "__init__.py", Path.is_file)):
        if not kind(path):
            print(f"{path}: -: file: got none, expected one", file=sys.stderr)
            return 3
    temporary = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as z:
            for name, path in collect(library, street):
                info = zipfile.ZipInfo(name, (2000, 1, 1, 0, 0, 0))
                info.compress_type, info.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
                z.writestr(info, path.read_bytes())
        with open(temporary, "rb") as f:
            os.fsync(f.fileno())
        os.replace(temporary, target)
    except OSError as e:
        temporary.unlink(missing_ok=True)
        print(f"{target}: -: write: got {e.strerror}, expected a whole file", file=sys.stderr)
        return 4
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
