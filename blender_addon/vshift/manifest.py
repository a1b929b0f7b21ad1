# SPDX-License-Identifier: GPL-3.0-or-later
"""manifest.json of a set: what is planned, done or refused. Standard library only; also a small program:

    python3 manifest.py status SET        counts as JSON; exit 0 when nothing is left to do, else 2
    python3 manifest.py verify SET        hashes every done file; exit 4 and one line each when some differ
    python3 manifest.py left SET FRAME    paths of the frame's items that are still to do
    python3 manifest.py record SET ITEM KIND   ITEM is done as it lies there now

An item is done only when its file is there and matches its sha256. Changes go through a lock file and are
written beside, fsynced and renamed, so that a kill at any moment leaves the old or the new manifest.
"""
import fcntl
import hashlib
import json
import os
import platform
import shutil
import sys
import time
from contextlib import contextmanager
from pathlib import Path

NAME = "manifest.json"
TEMP = ".tmp"
_FIXED = ("street", "render", "conventions", "versions")   # must be the same in every run of a set


class ManifestError(RuntimeError):
    def __init__(self, message, code=3):
        super().__init__(message)
        self.code = code


def load(set_dir):
    """The manifest as a dict, or None when the set has none. Code 3 for a file that is no manifest."""
    path = Path(set_dir) / NAME
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return None
    except OSError as e:
        raise ManifestError(f"{path}: -: file: got {e.strerror}, expected a readable file", 4) from e
    try:
        data = json.loads(text)
    except ValueError as e:
        raise ManifestError(f"{path}: -: JSON: got {e}, expected a manifest") from e
    if not isinstance(data, dict) or data.get("vshift_manifest") != 1 or not isinstance(data.get("items"), dict):
        raise ManifestError(f"{path}: -: vshift_manifest: got something else, expected 1 with items")
    return data


def sha256(path):
    h = hashlib.sha256()
    with open(path, "rb") as f:
        while block := f.read(1 << 20):
            h.update(block)
    return h.hexdigest()


def is_done(set_dir, manifest, name, rendered=None):
    """Whether the file of item `name` is there and matches; rendered=True also asks for a rendered one."""
    item = manifest["items"].get(name)
    if not item or item.get("status") != "done" or (rendered and not item.get("rendered", True)):
        return False
    path = Path(set_dir) / name
    try:
        return path.stat().st_size == item["bytes"] and sha256(path) == item["sha256"]
    except OSError:
        return False


def status(manifest):
    """{"planned": n, "done": n, "refused": n, "moved": n} of the items, by their entries."""
    out = {"planned": 0, "done": 0, "refused": 0, "moved": 0}
    for item in manifest["items"].values():
        out[item["status"]] += 1
        out["moved"] += "moved_to" in item
    return out


def left(manifest, frame=None):
    """Names of items still planned, of one frame or of all."""
    return [n for n, i in manifest["items"].items()
            if i["status"] == "planned" and (frame is None or i.get("frame") == frame)]


@contextmanager
def locked(set_dir):
    """Holds the set's lock; other processes that change the manifest wait."""
    Path(set_dir).mkdir(parents=True, exist_ok=True)
    with open(Path(set_dir) / ".manifest.lock", "a") as f:
        fcntl.flock(f, fcntl.LOCK_EX)
        yield


def _write(set_dir, data):
    path = Path(set_dir) / NAME
    temporary = path.with_name(f".{NAME}.new")       # under the lock there is one writer
    try:
        with open(temporary, "w", encoding="utf-8") as f:
            json.dump(data, f, indent=1)
            f.write("\n")
            f.flush()
            os.fsync(f.fileno())
        os.replace(temporary, path)
    except OSError as e:
        raise ManifestError(f"{path}: -: write: got {e.strerror}, expected a whole file", 4) from e


def plan(set_dir, header, items):
    """Creates or extends the manifest; returns it.

    header: street, render, conventions, versions, machine, shifts. items: name -> entry. What exists is
    kept; a header that contradicts the set is refused, field by field.
    """
    with locked(set_dir):
        data = load(set_dir)
        if data is None:
            data = {"vshift_manifest": 1, **header, "items": {}}
        where = Path(set_dir) / NAME
        for part in _FIXED:
            for key, want in header[part].items():
                got = data.get(part, {}).get(key)
                if got != want:
                    raise ManifestError(f"{where}: -: {part}.{key}: got {got} in the set, expected {want} "
                                        "(take another --out, or the set's own settings)")
        known = {s["name"] for s in data["shifts"]}
        data["shifts"] += [s for s in header["shifts"] if s["name"] not in known]
        for name, entry in items.items():
            data["items"].setdefault(name, {**entry, "status": "planned"})
        _write(set_dir, data)
        return data


def record(set_dir, name, **fields):
    """Sets fields of one item and returns the new manifest; status "done" needs sha256 and bytes (see `done`)."""
    return record_all(set_dir, {name: fields})


def record_all(set_dir, changes):
    """The same for several items at once: name -> fields; a field given as None is removed."""
    with locked(set_dir):
        data = load(set_dir)
        if data is None:
            raise ManifestError(f"{Path(set_dir) / NAME}: -: file: got none, expected a planned set", 4)
        for name, fields in changes.items():
            item = data["items"].setdefault(name, {"status": "planned"})
            for key, value in fields.items():
                if value is None:
                    item.pop(key, None)
                else:
                    item[key] = value
        _write(set_dir, data)
        return data


def done(set_dir, name, seconds, **fields):
    """Records an item as done, with the hash of the file that lies there now."""
    path = Path(set_dir) / name
    return record(set_dir, name, status="done", sha256=sha256(path), bytes=path.stat().st_size,
                  seconds=round(seconds, 3), **fields)


@contextmanager
def run_folder(set_dir):
    """A folder for this run's unfinished files; those of runs that died are removed first."""
    root = Path(set_dir) / TEMP
    with locked(set_dir):
        root.mkdir(exist_ok=True)
        for other in root.iterdir():
            _remove_if_dead(other)
        mine = root / f"{os.getpid()}-{time.time_ns()}"
        mine.mkdir()
        lock = open(mine / "lock", "w")
        fcntl.flock(lock, fcntl.LOCK_EX)
    try:
        yield mine
    finally:
        lock.close()
        shutil.rmtree(mine, ignore_errors=True)
        try:
            root.rmdir()
        except OSError:
            pass                                     # another run is at work


def _remove_if_dead(folder):
    try:
        with open(folder / "lock") as f:
            fcntl.flock(f, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return                                       # alive: it holds its lock
    except OSError:
        pass                                         # died before it made one
    shutil.rmtree(folder, ignore_errors=True)


def machine():
    """{"cores": n, "cpu": name}"""
    cpu = platform.processor() or platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                cpu = line.split(":", 1)[1].strip()
                break
    except OSError:
        pass
    return {"cores": len(os.sched_getaffinity(0)), "cpu": cpu}


def main(arguments):
    words = {"status": 2, "verify": 2, "left": 2, "record": 4}
    if not arguments or len(arguments) < words.get(arguments[0], len(arguments) + 1):
        print("manifest.py: -: verb: got something else, expected status SET | verify SET | left SET FRAME | "
              "record SET ITEM KIND", file=sys.stderr)
        return 3
    verb, set_dir = arguments[:2]
    try:
        data = load(set_dir)
        if data is None:
            raise ManifestError(f"{set_dir}/{NAME}: -: file: got none, expected a set")
        if verb == "status":
            counts = status(data)
            print(json.dumps(counts))
            return 2 if counts["planned"] else 0
        if verb == "left":
            frame = int(arguments[2]) if len(arguments) > 2 else None
            print("\n".join(left(data, frame)))
            return 0
        if verb == "record":
            done(set_dir, arguments[2], 0.0, kind=arguments[3])
            return 0
        bad = [n for n, i in data["items"].items() if i["status"] == "done" and not is_done(set_dir, data, n)]
        for name in bad:
            print(f"{set_dir}/{name}: -: sha256: got another file, expected {data['items'][name]['sha256']}",
                  file=sys.stderr)
        return 4 if bad else 0
    except ManifestError as e:
        print(e, file=sys.stderr)
        return e.code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
