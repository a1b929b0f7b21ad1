#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Makes the report of a benchmark set: one HTML file that opens offline.

    /usr/bin/python3 benchmark/report/make_report.py SET_DIR [-o report.html] [--strip strip.png]

Exit codes: 0 done, 3 bad usage or a broken set, 4 reading or writing failed, 6 our bug, 130 interrupted.
"""
import argparse
import datetime
import os
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from report import facts, fills, pictures, pool  # noqa: E402
from report.read_set import BAD_INPUT, IO_FAILED, ReportError, read_set  # noqa: E402

HERE = Path(__file__).resolve().parent


class Parser(argparse.ArgumentParser):
    """argparse that ends with the product's code for bad usage, in one line."""

    def error(self, message):
        raise ReportError(BAD_INPUT, f"report: {message}")


def write_whole(path, content):
    """Write a file whole or not at all: beside, fsync, rename. An old file stays when this fails."""
    path = Path(path)
    beside = None
    try:
        handle, beside = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(beside, 0o666 & ~mask)
        if path.is_dir():
            raise IsADirectoryError(21, "Is a directory")
        os.replace(beside, path)
        beside = None
    except OSError as error:
        raise ReportError(IO_FAILED, f"{path.name}: file: got {error.strerror}, expected to write {len(content)} bytes") from None
    finally:
        if beside and os.path.exists(beside):
            os.unlink(beside)


def render(data, max_bytes, max_frames, width):
    """The report as HTML bytes."""
    images, views, used_width = pictures.embed(data, max_bytes, max_frames, width)
    import jinja2  # here, so that a broken set is refused before the slow imports
    from report import charts
    environment = jinja2.Environment(loader=jinja2.FileSystemLoader(HERE), autoescape=True, trim_blocks=True,
                                     lstrip_blocks=True, undefined=jinja2.StrictUndefined)
    environment.filters["percent"] = facts.percent
    page = environment.get_template("report.html.j2").render(
        facts=facts.facts(data), charts=charts.charts(data), tables=facts.tables(data), fills=fills.tables(data["scores"]),
        css=(HERE / "report.css").read_text("utf-8"), js=(HERE / "report.js").read_text("utf-8"),
        frames_shown=list(views), width_shown=used_width, made=made_on(),
        page_data={"images": images, "views": views, "frames": list(views), "cameras": data["cameras"],
                   "methods": data["methods"], "methodNames": {m: pool.METHOD_NAME[m] for m in data["methods"]},
                   "shifts": [{"name": s["name"], "label": facts.label(s)} for s in data["manifest"]["shifts"]],
                   "differenceFullScale": pictures.DIFFERENCE_FULL_SCALE,
                   "arms": [{"name": a, "label": fills.arm_name(a)} for a in fills.picture_arms(data["scores"])]})
    return page.encode("utf-8")


def made_on():
    """Today, or the day of SOURCE_DATE_EPOCH for reports that must repeat."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "")
    zone = datetime.timezone.utc
    when = datetime.datetime.fromtimestamp(int(epoch), zone) if epoch.isdigit() else datetime.datetime.now(zone)
    return when.strftime("%Y-%m-%d")


def record(folder, file):
    """A file that lies in the set is an item of its manifest."""
    folder, file = folder.resolve(), Path(file).resolve()
    if not file.is_relative_to(folder):
        return
    helper = HERE.parents[1] / "blender_addon" / "vshift" / "manifest.py"
    done = subprocess.run([sys.executable, helper, "record", folder, file.relative_to(folder), "report"], capture_output=True, text=True)
    if done.returncode:
        raise ReportError(IO_FAILED, done.stderr.strip() or f"{helper}: record: got exit {done.returncode}, expected 0")


def run(arguments):
    """Parse, read, make, write."""
    parser = Parser(prog="report", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", help="the folder of a benchmark set")
    parser.add_argument("-o", "--out", help="the HTML file (default: SET/report.html)")
    parser.add_argument("--strip", metavar="FILE", help="also write a strip of one camera, 1600 px wide (.png or .jpg)")
    parser.add_argument("--strip-camera", metavar="NAME", help="camera of the strip (default: CAM_FRONT, or the first)")
    parser.add_argument("--strip-shift", metavar="NAME", help="shift of the strip (default: one of about 2 m)")
    parser.add_argument("--strip-method", choices=("self", "rig"), help="geometry of the strip (default: self)")
    parser.add_argument("--strip-columns", type=int, choices=(1, 2, 4), default=4, help="panels side by side (default: 4)")
    parser.add_argument("--max-mb", type=float, default=13.0, help="megabytes of pictures to embed (default: 13)")
    parser.add_argument("--max-frames", type=int, default=12, help="frames to embed pictures of, at most (default: 12)")
    parser.add_argument("--max-width", type=int, default=640, help="width of embedded pictures, at most (default: 640)")
    args = parser.parse_args(arguments)
    if not args.max_mb > 0 or args.max_frames < 1 or args.max_width < 16:
        parser.error("--max-mb, --max-frames, --max-width: got too little, expected more than 0, at least 1, at least 16")
    data = read_set(args.set)
    picture = None
    if args.strip:
        from report.strip import strip
        picture = strip(data, args.strip_camera, args.strip_shift, args.strip_method, args.strip_columns,
                        jpeg=Path(args.strip).suffix.lower() in (".jpg", ".jpeg"))
    out = Path(args.out) if args.out else data["folder"] / "report.html"
    page = render(data, args.max_mb * 1e6, args.max_frames, args.max_width)
    for file, content in [(out, page)] + ([(Path(args.strip), picture)] if picture else []):
        write_whole(file, content)
        record(data["folder"], file)
        print(f"{file}: {len(content) / 1e6:.1f} MB")


def main(arguments):
    """Run, with every failure as one line and an exit code."""
    try:
        run(arguments)
        return 0
    except ReportError as error:
        print(f"vshift: {error}", file=sys.stderr)
        return error.code
    except KeyboardInterrupt:
        return 130
    except Exception as error:  # the edge: a bug of ours must not look like the user's
        if os.environ.get("VSHIFT_TRACEBACK"):
            raise
        text = " ".join(str(error).split())
        print(f"vshift: report: bug: got {type(error).__name__} {text}, expected none (VSHIFT_TRACEBACK=1 shows where)", file=sys.stderr)
        return 6


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
