# SPDX-License-Identifier: GPL-3.0-or-later
"""Headless work in Blender:

    blender -b --factory-startup --python-exit-code 3 -P blender_addon/run.py -- VERB ...

    set     builds a benchmark set, or goes on with one that was killed
    truth   the same by rays alone: mesh, depth and truth classes, nothing rendered
    proof   our ray tracer against Cycles and Blender on the same street; JSON on standard output
    street  the street's geometry hash and counts; JSON on standard output

Exit codes: 0 done; 2 the proof fell below a threshold; 3 bad usage or input; 4 reading or writing failed;
6 our bug; 130 interrupted. Errors are one line: `file: camera: field: got X, expected Y`.
"""
import argparse
import json
import os
import sys
import traceback
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from vshift import manifest, progress, set_builder  # noqa: E402
from vshift.core import VshiftError  # noqa: E402


class _Parser(argparse.ArgumentParser):
    def error(self, message):
        raise VshiftError(f"run.py: -: usage: got {message}, expected {self.format_usage().strip()}", 3)


def parse_shifts(text):
    """"0,1,0;0,-1,0" or with a yaw in degrees "0,1,0,5" -> [(x, y, z, yaw_deg)]."""
    out = []
    for part in filter(None, (p.strip() for p in text.split(";"))):
        try:
            numbers = [float(v) for v in part.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) not in (3, 4) or not all(abs(v) < 1e3 for v in numbers):
            raise VshiftError(f"run.py: -: --shifts: got '{part}', expected x,y,z or x,y,z,yaw_deg", 3)
        out.append((*numbers, 0.0)[:4])
    return out


def parse_only(text):
    """"frames=0,2;cameras=CAM_FRONT" -> (frames or None, cameras or None)."""
    frames = cameras = None
    for part in filter(None, (text or "").split(";")):
        key, _, value = part.partition("=")
        try:
            if key == "frames":
                frames = [int(v) for v in value.split(",")]
            elif key == "cameras":
                cameras = value.split(",")
            else:
                raise ValueError
        except ValueError:
            raise VshiftError(f"run.py: -: --only: got '{part}', expected frames=0,1 or cameras=CAM_FRONT", 3) from None
    return frames, cameras


def _arguments(words):
    top = _Parser(prog="run.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = top.add_subparsers(dest="verb", required=True, parser_class=_Parser)
    for verb in ("set", "truth", "proof", "street"):
        p = verbs.add_parser(verb)
        p.add_argument("--seed", type=int, default=1)
        p.add_argument("--detail", type=int, default=2)
        p.add_argument("--length-m", type=float, default=240.0)
        p.add_argument("--traffic", type=float, default=1.0)
        p.add_argument("--threads", type=int, default=0, help="0: every core")
        if verb == "street":
            continue
        p.add_argument("--width", type=int, default=1600 if verb == "truth" else 400)
        p.add_argument("--height", type=int, default=900 if verb == "truth" else 225)
        if verb == "proof":
            p.add_argument("--json", type=Path, help="also write the figures here")
            continue
        p.add_argument("--out", type=Path, required=True)
        p.add_argument("--frames", type=int, default=1)
        p.add_argument("--dt-s", type=float, default=set_builder.STREET_HZ_DT_S)
        p.add_argument("--shifts", default="0,1,0;0,-1,0;0,2,0;0,-2,0;0,4,0;0,-4,0")
        p.add_argument("--only", help="frames=0,1 and/or cameras=CAM_FRONT, separated by ';'")
        p.add_argument("--on-collision", default="refuse", choices=("refuse", "move"))
        p.add_argument("--clearance-m", type=float, default=0.3)
        if verb == "set":
            p.add_argument("--samples", type=int, default=8, help="a pixel; 8 filtered is better than 16 unfiltered")
            p.add_argument("--no-smooth", action="store_true", help="leave Cycles' noise as it is")
            p.add_argument("--what", default="all", choices=("street", "views", "truth", "all"))
    return top.parse_args(words)


def main(words):
    a = _arguments(words)
    if a.verb == "street":
        street = set_builder.generate_street(a)
        print(json.dumps({**set_builder.street_figures(street, a), "parts": len(street.parts),
                          "instances": len(street.instances), "movers": len(street.movers)}, indent=1), flush=True)
        return 0
    if a.verb == "proof":
        from vshift import proof
        figures = proof.run(a.seed, a.detail, a.width, a.height, a.length_m, a.traffic, a.threads)
        text = json.dumps(figures, indent=1)
        print(text, flush=True)
        if a.json:
            a.json.write_text(text + "\n")
        for name in figures["failed"]:
            c = figures["checks"][name]
            print(f"proof: {c.get('camera', '-')}: {name}: got {c['got']}, expected {c['expected']}", file=sys.stderr)
        return 2 if figures["failed"] else 0
    frames, cameras = parse_only(a.only)
    rays = a.verb == "truth"
    options = set_builder.Options(
        out=a.out.resolve(), seed=a.seed, detail=a.detail, frames=a.frames, dt_s=a.dt_s, length_m=a.length_m,
        traffic=a.traffic, width=a.width, height=a.height, samples=1 if rays else a.samples,
        smooth=False if rays else not a.no_smooth, shifts=parse_shifts(a.shifts), only_frames=frames,
        only_cameras=cameras, what="rays" if rays else a.what, threads=a.threads, on_collision=a.on_collision,
        clearance_m=a.clearance_m)
    print("vshift: " + json.dumps(set_builder.build_set(options)), file=sys.stderr, flush=True)
    return 0


def guarded(words):
    """main with every failure turned into one line and an exit code."""
    try:
        progress.install_signal_handlers()
        return main(words)
    except SystemExit as e:
        return e.code or 0
    except BaseException as e:  # noqa: BLE001  the edge of the program
        name = progress.interrupted_by()
        if not name:
            return failed(e)
        print(f"vshift: interrupted by {name}; run the same command again to go on", file=sys.stderr)
        return 130


def failed(error):
    """One line for an error; its exit code."""
    try:
        raise error
    except (VshiftError, manifest.ManifestError) as e:
        print(e, file=sys.stderr)
        return e.code
    except OSError as e:
        print(f"{e.filename or '-'}: -: file: got {e.strerror or e}, expected to read or write it", file=sys.stderr)
        return 4
    except Exception as e:  # noqa: BLE001
        traceback.print_exc()
        print(f"run.py: -: bug: got {type(e).__name__}: {e}, expected no such thing", file=sys.stderr)
        return 6


if __name__ == "__main__":
    code = guarded(sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else ["--help"])
    sys.stdout.flush()
    sys.stderr.flush()
    # Blender's own exit takes seconds with a big scene and loses the code in some versions
    import shutil
    import bpy
    shutil.rmtree(bpy.app.tempdir, ignore_errors=True)
    os._exit(code)
