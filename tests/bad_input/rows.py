# SPDX-License-Identifier: Apache-2.0
"""The table of bad inputs: (name, how the base is spoiled, words after `vshift`, exit code, regex).

The regex must match the error line from right after `vshift: `.
"""
import json
import os
import struct

import numpy as np

from base_case import HEIGHT, WIDTH, exr, exr_window, npy, pfm, png, scene_depth

MASK = "mask r.vshift -o out/m.exr"
WARP = "warp r.vshift -o out/m.exr"
SEAM = "seam r.vshift -o out/m.exr"
CONDITION = "condition r.vshift -o out/m.exr"
IO, LIMIT = 4, 5


# -- ways to spoil ------------------------------------------------------------------------------------

def good(base):
    pass


def top(**fields):
    return lambda b: (b.recipe.update(fields), b.save())


def cam(**fields):
    return lambda b: (b.recipe["cameras"][0].update(fields), b.save())


def frame(**fields):
    return lambda b: (b.recipe["frames"][0].update(fields), b.save())


def without(part, key):
    return lambda b: (b.recipe.pop(key) if part is None else b.recipe[part][0].pop(key), b.save())


def sub(old, new):
    def spoil(b):
        text = json.dumps(b.recipe)
        assert old in text
        b.text(text.replace(old, new, 1))
    return spoil


def text(content):
    return lambda b: b.text(content)


def intrinsic(row, column, value):
    return lambda b: (b.recipe["cameras"][0]["intrinsic"][row].__setitem__(column, value), b.save())


def depth(content):
    """The depth's bytes: given, or made from the good ones."""
    return lambda b: b.depth.write_bytes(content(b.depth.read_bytes()) if callable(content) else content)


def named(name, content):
    """Depth from a file of another name."""
    return lambda b: ((b / name).write_bytes(content), cam(depth=name)(b))


def cut(share):
    return depth(lambda data: data[:int(len(data) * share)])


def replaced(make):
    """Depth removed, `make(path)` in its place."""
    return lambda b: (b.depth.unlink(), make(b.depth))


def image(content):
    return lambda b: ((b / "a.png").write_bytes(content), cam(image="a.png")(b))


def channels(*names, width=WIDTH, height=HEIGHT):
    return replaced(lambda p: exr(p, {n: scene_depth(width, height) for n in names}))


def halve(path):
    os.truncate(path, path.stat().st_size // 2)


def manifest(**changes):
    return lambda b: b.manifest(**changes)


def item(value):
    return lambda b: b.manifest(items={"frames/0000/A.exr": value})


def files(*steps):
    return lambda b: [step(b) for step in steps]


def write(name, content):
    def spoil(b):
        (b / name).parent.mkdir(parents=True, exist_ok=True)
        (b / name).write_bytes(content)
    return spoil


def scored(**attributes):
    return lambda b: b.scored(**attributes)


def report_set(b):
    """A manifest and a recipe as the report wants them; no scores yet."""
    b.manifest(versions={}, machine={}, street={}, render={"width": WIDTH, "height": HEIGHT})
    (b / "set.vshift").write_text(json.dumps(b.recipe))


def nested(levels):
    return "[" * levels + "]" * levels


# -- the recipe ---------------------------------------------------------------------------------------

R = r"r\.vshift: "
RECIPE = [
    ("unknown key", top(shfit=[0, 1, 0]), MASK, 3, R + r"'shfit': got an unknown key, expected one of .*did you mean shift\?"),
    ("unknown key in camera", cam(widht=64), MASK, 3, R + r"A: 'widht': got an unknown key, .*did you mean width\?"),
    ("unknown key in frame", frame(indx=0), MASK, 3, R + r"frames\[0\]: 'indx': got an unknown key, .*did you mean index\?"),
    ("duplicate key", sub('"vshift": 1', '"vshift": 1, "vshift": 1'), MASK, 3, R + "vshift: got the key twice, expected it once"),
    ("duplicate key in camera", sub('"width": 64', '"width": 64, "width": 32'), MASK, 3, R + ".*width: got the key twice, expected it once"),
    ("duplicate key, two lines", sub('"vshift": 1', r'"vshift": 1, "a\nb": 1, "a\nb": 1'), MASK, 3, R + ".*got the key twice"),
    ("name is a number", cam(name=7), MASK, 3, R + r"cameras\[0\]: name: got 7, expected text"),
    ("width is text", cam(width="64"), MASK, 3, R + "A: width: got '64', expected a whole number"),
    ("width 1600.7", cam(width=1600.7), MASK, 3, R + r"A: width: got 1600\.7, expected a whole number"),
    ("width -1", cam(width=-1), MASK, 3, R + "A: width: got -1, expected a whole number from 1"),
    ("huge width", cam(width=10 ** 9), MASK, LIMIT, R + "A: width: got 1000000000, expected at most 16384"),
    ("1e999", sub('"width": 64', '"width": 1e999'), MASK, 3, R + "json: got number overflow.*, expected valid JSON"),
    ("NaN literal", sub('"width": 64', '"width": NaN'), MASK, 3, R + "json: got .*, expected valid JSON"),
    ("nesting 100k", text(nested(100000)), MASK, 3, R + "json: got nesting deeper than 16, expected"),
    ("nesting 100k in a key", lambda b: b.text(json.dumps(b.recipe)[:-1] + ', "x": ' + '{"a":' * 100000), MASK, 3, R + "json: got nesting"),
    ("empty", text(""), MASK, 3, R + "json: got .*, expected valid JSON"),
    ("binary", text(bytes(range(256)) * 8), MASK, 3, R + "json: got .*, expected valid JSON"),
    ("bad UTF-8", text(b'{"vshift": 1, "\xff\xfe": 1}'), MASK, 3, R + "json: got .*, expected valid JSON"),
    ("truncated", lambda b: b.text(json.dumps(b.recipe)[:200]), MASK, 3, R + "json: got .*, expected valid JSON"),
    ("fx = 0", intrinsic(0, 0, 0), MASK, 3, R + r"A: intrinsic\[0\]\[0\]: got fx = 0\.0, expected fx > 0"),
    ("tiny fx", intrinsic(0, 0, 1e-300), MASK, 3, R + "A: intrinsic: got .*, expected focal lengths"),
    ("skew", intrinsic(0, 1, 0.5), MASK, 3, R + r"A: intrinsic: got skew 0\.5, expected no skew"),
    ("singular", cam(intrinsic=[[0, 0, 0]] * 3), MASK, 3, R + "A: intrinsic.*: got .*, expected fx > 0"),
    ("last row", intrinsic(2, 2, 2), MASK, 3, R + r"A: intrinsic\[2\]: got \[0\.0,0\.0,2\.0\], expected \[0,0,1\]"),
    ("rotation not unit", cam(rotation=[1, 1, 0, 0]), MASK, 3, R + r"A: rotation: got .*length 1\.41.*, expected a rotation"),
    ("zero quaternion", cam(rotation=[0, 0, 0, 0]), MASK, 3, R + "A: rotation: got .*length 0.*, expected a rotation"),
    ("3-element rotation", cam(rotation=[0, 0, 1]), MASK, 3, R + "A: rotation: got an array of 3, expected 4 numbers"),
    ("no depth", without("cameras", "depth"), MASK, 3, R + "A: depth: got nothing, expected a depth map"),
    ("path climbs out", cam(depth="../x.exr"), MASK, 3, R + r"A: depth: got '\.\./x\.exr', expected a path that stays below"),
    ("absolute path", cam(depth="/tmp/x.exr"), MASK, 3, R + "A: depth: got '/tmp/x.exr', expected a path relative"),
    ("pattern %n", cam(depth="%04d/%n.exr"), MASK, 3, R + "A: depth: got '%04d/%n.exr', expected at most one"),
    ("duplicate names", lambda b: (b.recipe["cameras"][1].update(name="A"), b.save()), MASK, 3, R + "A: name: got the name twice, expected"),
    ("slash in name", cam(name="A/B"), MASK, 3, R + ".*name: got 'A/B', expected a name of letters"),
    ("name with a new line", cam(name="A\nvshift: B"), MASK, 3, R + ".*name: got .*, expected a name of letters"),
    ("depth scale 0", cam(depth_scale_m=0), MASK, 3, R + r"A: depth_scale_m: got 0\.0, expected > 0"),
    ("duplicate frames", lambda b: (b.recipe["frames"][1].update(index=0), b.save()), MASK, 3, R + r"frames\[1\]: index: got 0 twice, expected"),
    ("no cameras", top(cameras=[]), MASK, 3, R + "cameras: got an array of 0, expected an array of 1 to 64"),
    ("65 cameras", lambda b: (b.recipe.update(cameras=[{**b.recipe["cameras"][0], "name": f"C{i}"} for i in range(65)]), b.save()),
     MASK, 3, R + "cameras: got an array of 65, expected an array of 1 to 64"),
    ("no frames", top(frames=[]), MASK, 3, R + "frames: got an array of 0, expected an array of 1"),
    ("unknown camera in frame", frame(cameras={"C": {}}), MASK, 3, R + r"camera: got 'C', expected one of A, B"),
    ("version 2", top(vshift=2), MASK, 3, R + "vshift: got 2, expected 1"),
    ("version missing", without(None, "vshift"), MASK, 3, R + "vshift: got nothing, expected 1"),
    ("default view of another out", top(view="shifted"), MASK, 3, R + "view: got 'shifted', expected recorded for out=mask"),
    ("recipe missing", lambda b: (b / "r.vshift").unlink(), MASK, IO, R + "reading: got No such file.*, expected a readable file"),
    ("recipe is a folder", good, "mask out -o out/m.exr", IO, "out: file: got a folder, expected a regular file"),
    ("recipe is a FIFO", lambda b: os.mkfifo(b / "f.vshift"), "mask f.vshift -o out/m.exr", IO, "f.vshift: file: got a FIFO, expected"),
    ("recipe is a device", lambda b: (b / "d.vshift").symlink_to("/dev/zero"), "mask d.vshift -o out/m.exr", IO, "d.vshift: file: got a char.* device"),
    ("recipe of 1 GB", lambda b: os.truncate(b / "r.vshift", 1 << 30), MASK, LIMIT, R + "size: got 1073741824 bytes, expected at most 67108864"),
    ("recipe's name has a new line", lambda b: (b / "a\nb").write_text("{"), ["mask", "a\nb", "-o", "out/m.exr"], 3, r"a\?b: json: got .*, expected valid"),
]

# -- the request --------------------------------------------------------------------------------------

REQUEST = [
    ("number with letters", good, MASK + " --shift 0,1m,0", 3, R + "shift: got '1m', expected a finite number"),
    ("locale comma", good, MASK + " --shift 0,5,0,0", 3, R + "shift: got '0,5,0,0', expected three numbers"),
    ("empty shift", good, [*MASK.split(), "--shift", ""], 3, R + "shift: got '', expected three numbers"),
    ("inf", good, MASK + " --shift inf,0,0", 3, R + "shift: got 'inf', expected a finite number"),
    ("nan", good, MASK + " --shift nan,0,0", 3, R + "shift: got 'nan', expected a finite number"),
    ("huge shift", good, MASK + " --shift 1e9,0,0", 3, R + "shift: got '1e9,0,0', expected at most 1000000 m"),
    ("shift with a new line", good, [*MASK.split(), "--shift", "0,\n,0"], 3, R + r"shift: got '\?', expected a finite number"),
    ("yaw with unit", good, MASK + " --yaw-deg 5deg", 3, R + "yaw_deg: got '5deg', expected a finite number"),
    ("unknown camera", good, MASK + " --camera AA", 3, R + r"camera: got 'AA', expected one of A, B \(did you mean A\?\)"),
    ("unknown frame", good, MASK + " --frame 7", 3, R + "frame: got 7, expected one of the 2 frames from 0 to 1"),
    ("frame -1", good, MASK + " --frame=-1", 3, R + "frame: got '-1', expected a whole number >= 0"),
    ("sweep of the rig", good, MASK + " --method sweep --from rig", 3, R + r"method: got 'sweep' for out=mask, from=rig, expected"),
    ("unknown method", good, MASK + " --method embre", 3, R + r"method: got 'embre', expected one of .*did you mean embree\?"),
    ("raster of a mask", good, MASK + " --method raster", 3, R + r"method: got 'raster' for out=mask, from=self, expected out=holes"),
    ("sweep of a seam", good, SEAM + " --method sweep", 3, R + r"method: got 'sweep' for out=seam, from=self, expected .*method=raster"),
    ("seam from the rig", good, SEAM + " --from rig", 3, R + "from: got 'rig' for out=seam, expected self"),
    ("unknown edge", good, SEAM + " --edge dropp", 3, R + r"edge: got 'dropp', expected .*did you mean drop\?"),
    ("unknown match", good, SEAM + " --match colour", 3, R + r"match: got 'colour', expected .*did you mean color\?"),
    ("unknown arm", good, CONDITION + " --arm litteral", 3, R + r"arm: got 'litteral', expected .*did you mean literal\?"),
    ("arm of the other view", good, CONDITION + " --arm literal --view shifted", 3, R + "view: got 'shifted', expected recorded for arm=literal"),
    ("splat of the recorded view", good, CONDITION + " --arm splat", 3, R + "view: got 'recorded', expected shifted for arm=splat"),
    ("stride 0", good, CONDITION + " --stride 0", 3, R + "stride: got '0', expected a whole number from 1 to 256"),
    ("stride 1.5", good, CONDITION + " --stride 1.5", 3, R + "stride: got '1.5', expected a whole number"),
    ("stride of a seam", good, SEAM + " --stride 8", 3, "usage: .*--stride"),
    ("depth tolerance 2", good, SEAM + " --depth-tolerance 2", 3, R + "depth_tolerance: got '2', expected a share of the depth"),
    ("seed -1", good, SEAM + " --noise-seed=-1", 3, R + "noise_seed: got '-1', expected a whole number"),
    ("exposure nan", good, SEAM + " --noise-exposure nan", 3, R + "noise_exposure: got 'nan', expected a finite number"),
    ("white balance 9", good, SEAM + " --noise-white-balance 9", 3, R + "noise_white_balance: got '9', expected stops"),
    ("pose -1", good, SEAM + " --noise-pose-m=-1", 3, R + "noise_pose_m: got '-1', expected metres from 0 to 10"),
    ("pose 90 degrees", good, SEAM + " --noise-pose-deg 90", 3, R + "noise_pose_deg: got '90', expected degrees from 0 to 45"),
    ("time 11", good, SEAM + " --noise-time-s 11", 3, R + "noise_time_s: got '11', expected seconds from 0 to 10"),
    ("depth scale 2", good, SEAM + " --noise-depth-scale 2", 3, R + "noise_depth_scale: got '2', expected a share"),
    ("depth bias -1", good, SEAM + " --noise-depth-bias-m=-1", 3, R + "noise_depth_bias_m: got '-1', expected metres"),
    ("depth blur 65", good, SEAM + " --noise-depth-blur-px 65", 3, R + "noise_depth_blur_px: got '65', expected pixels"),
    ("depth field x", good, SEAM + " --noise-depth-field x", 3, R + "noise_depth_field: got 'x', expected a finite number"),
    ("noise key of a recipe", top(noise_pose_m="far"), MASK, 3, R + "noise_pose_m: got 'far', expected a finite number"),
    ("no image for a seam", without("cameras", "image"), SEAM, 3, R + "A: image: got nothing, expected a picture"),
    ("unknown view", good, MASK + " --view shift", 3, R + r"view: got 'shift', expected .*did you mean shifted\?"),
    ("view of another out", good, MASK + " --view shifted", 3, R + "view: got 'shifted', expected recorded for out=mask"),
    ("tolerance -1", good, MASK + " --tolerance-px=-1", 3, R + "tolerance_px: got '-1', expected 0"),
    ("clear -1", good, MASK + " --clear-m=-1", 3, R + "clear_m: got '-1', expected metres from 0"),
    ("unknown depth source", good, MASK + " --depth-source monocular", 3, R + r"depth_source: got 'monocular', expected one of auto, .*did you mean mono\?"),
    ("shift twice", good, MASK + " --shift 0,1,0 --shift 0,2,0", 3, ".*shift.*"),
    ("unknown flag", good, MASK + " --shfit 0,1,0", 3, "usage: .*--shfit.*--shift"),
    ("unknown flag, two lines", good, [*MASK.split(), "--a\nb"], 3, "usage: .*"),
    ("no value", good, "mask r.vshift -o", 3, "usage: .*"),
    ("no verb", good, "", 3, "usage: .*"),
    ("unknown verb", good, "msak r.vshift -o out/m.exr", 3, "usage: .*msak.*mask"),
    ("no recipe", good, "mask -o out/m.exr", 3, "usage: .*recipe"),
    ("no output", good, "mask r.vshift", 3, "usage: got neither of -o and --out-dir, expected one of them"),
    ("both outputs", good, MASK + " --out-dir out", 3, "usage: got both of -o and --out-dir, expected one of them"),
    ("many cameras with -o", good, MASK + " --camera *", 3, "usage: got 2 cameras.*, expected --out-dir"),
    ("all frames with -o", good, MASK + " --all-frames", 3, "usage: got .*all frames.*, expected --out-dir"),
    ("unknown channel", good, MASK + " --channels lots", 3, ".*channel: got lots, expected one of lost.*nearest: lost"),
    ("channel twice", good, MASK + " --channels lost,lost", 3, ".*channel.*: got lost twice, expected"),
    ("min-f1 nan", scored(), "score r.vshift -o out/m.exr --min-f1 nan", 3, "usage: .*--min-f1"),
]

# -- depth and colour files ---------------------------------------------------------------------------

A = r"(\./)?frames/0000/A\.exr: "
IMAGES = [
    ("missing", lambda b: b.depth.unlink(), MASK, IO, A + "reading: got No such file"),
    ("a folder", replaced(os.mkdir), MASK, IO, A + "file: got a folder, expected a regular file"),
    ("a FIFO", replaced(os.mkfifo), MASK, IO, A + "file: got a FIFO, expected a regular file"),
    ("/dev/zero", replaced(lambda p: p.symlink_to("/dev/zero")), MASK, IO, A + "file: got a character device, expected"),
    ("a loop of links", replaced(lambda p: p.symlink_to("A.exr")), MASK, IO, A + "reading: got Too many levels"),
    ("empty file", depth(b""), MASK, 3, A + "format: got an empty file, expected EXR"),
    *[(f"EXR cut at {share:.1%}", cut(share), MASK, 3, A + ".*: got .*, expected") for share in (.001, .02, .1, .5, .9)],
    ("EXR without its last byte", depth(lambda d: d[:-1]), MASK, 3, A + ".*: got .*, expected"),
    ("EXR with zeros inside", depth(lambda d: d[:len(d) // 2] + b"\0" * (len(d) - len(d) // 2)), MASK, 3, A + "pixels: got .*, expected a whole file"),
    ("wrong size", channels("Z", width=32), MASK, 3, A + "size: got 32x36, expected 64x36"),
    ("wrong channel", channels("Depth"), MASK, 3, A + r"channel: got Z, expected one of Depth \(nearest: Depth\)"),
    ("deep EXR", depth(lambda d: d[:4] + struct.pack("<I", 0x802) + d[8:]), MASK, 3, A + "EXR kind: got deep samples, expected flat"),
    ("multi-part EXR", depth(lambda d: d[:4] + struct.pack("<I", 0x1002) + d[8:]), MASK, 3, A + "EXR parts: got a multi-part file, expected"),
    ("EXR of 2^31 pixels a side", depth(lambda d: exr_window(d, 2 ** 31 - 2, 2 ** 31 - 2)), MASK, (3, LIMIT), A + "size: got 2147483647x2147483647.*, expected"),
    ("EXR claims 16384x16384", lambda b: (depth(lambda d: exr_window(d, 16383, 16383))(b), cam(width=16384, height=16384)(b)), MASK, 3, A + "EXR chunks: got .*, expected at least"),
    ("8 GB of nothing", lambda b: os.truncate(b.depth, 8 << 30), MASK, LIMIT, A + "size: got 8589934592 bytes, expected at most"),
    ("8-bit PNG", named("d.png", png(WIDTH, HEIGHT, 8)), MASK, 3, "(\\./)?d.png: sample type: got 8-bit integers, expected 16-bit"),
    ("PNG claims 46340x46340", named("d.png", png(1, 1, 16, (46340, 46340))), MASK, (3, LIMIT), "(\\./)?d.png: size: got 46340x46340.*, expected"),
    ("PNG claims 16384x16384", files(named("d.png", png(1, 1, 16, (16384, 16384))), cam(width=16384, height=16384)), MASK, (3, LIMIT), "(\\./)?d.png: .*: got .*, expected"),
    ("PNG cut", named("d.png", png(WIDTH, HEIGHT, 16)[:-20]), MASK, 3, "(\\./)?d.png: .*: got .*, expected"),
    ("PNG with a bad checksum", named("d.png", png(WIDTH, HEIGHT, 16)[:45] + b"\xff\xff" + png(WIDTH, HEIGHT, 16)[47:]), MASK, 3, "(\\./)?d.png: .*: got .*, expected"),
    ("NPY Fortran order", named("d.npy", npy(fortran=True)), MASK, 3, "(\\./)?d.npy: NPY fortran_order: got True, expected False"),
    ("NPY of objects", named("d.npy", npy(descr="|O")), MASK, 3, r"(\./)?d.npy: NPY descr: got \|O, expected <f4"),
    ("NPY lies about its shape", named("d.npy", npy(count=5)), MASK, 3, "(\\./)?d.npy: size: got .* bytes, expected"),
    ("NPY of 2^62 pixels", named("d.npy", npy("(4611686018427387904, 4611686018427387904)")), MASK, (3, LIMIT), "(\\./)?d.npy: .*: got .*, expected"),
    ("NPY shape negative", named("d.npy", npy("(-36, 64)")), MASK, 3, "(\\./)?d.npy: NPY header: got .*, expected"),
    ("NPY of three planes", named("d.npy", npy("(36, 64, 3)", count=3 * WIDTH * HEIGHT)), MASK, 3, "(\\./)?d.npy: channels: got 3, expected 1"),
    ("PFM absurd header", named("d.pfm", pfm("Pf\n99999999999999999999 1\n-1\n")), MASK, 3, "(\\./)?d.pfm: PFM width: got 9+, expected a number"),
    ("PFM cut", named("d.pfm", pfm(count=100)), MASK, 3, "(\\./)?d.pfm: size: got .* bytes, expected"),
    ("text named .exr", depth(b"no picture, just words\n"), MASK, 3, A + "format: got unknown first bytes, expected EXR"),
    ("no image for warp", without("cameras", "image"), WARP, 3, R + "A: image: got nothing, expected a picture"),
    ("image missing for warp", cam(image="no.exr"), WARP, IO, "(\\./)?no.exr: reading: got No such file"),
    ("image of another size", image(png(32, 36, 8)), WARP, 3, r"(\./)?a.png: size: got 32x36, expected 64x36"),
    ("image without colours", lambda b: (channels("Z")(b)), WARP, 3, A + "channel: got R, expected one of Z"),
    ("image cut", image(png(WIDTH, HEIGHT, 8)[:60]), WARP, 3, r"(\./)?a.png: .*: got .*, expected"),
]

# -- outputs ------------------------------------------------------------------------------------------

TO = "mask r.vshift -o "
OUTPUTS = [
    ("no such folder", good, TO + "no/m.exr", IO, "no/m.exr: writing: got No such file or directory, expected"),
    ("a folder", good, TO + "out", (3, IO), "out: .*: got .*, expected"),
    ("a folder named .exr", lambda b: (b / "d.exr").mkdir(), TO + "d.exr", IO, "d.exr: file: got a folder, expected a regular file"),
    ("a FIFO", lambda b: os.mkfifo(b / "f.exr"), TO + "f.exr", IO, "f.exr: file: got a FIFO, expected a regular file"),
    ("a device", lambda b: (b / "z.exr").symlink_to("/dev/null"), TO + "z.exr", IO, "z.exr: file: got a character device, expected"),
    ("unknown ending", good, TO + "out/m.tiff", 3, "out/m.tiff: ending: got .tiff, expected .exr"),
    ("below a file", good, TO + "r.vshift/m.exr", IO, "r.vshift/m.exr: writing: got Not a directory, expected"),
    ("out-dir below a file", good, "mask r.vshift --out-dir r.vshift/x", IO, "r.vshift/x/.*: folder: got Not a directory, expected"),
    ("overlong name", good, TO + "out/" + "m" * 300 + ".exr", IO, "out/m+.exr: writing: got File name too long, expected"),
    ("PNG of 5 channels", good, TO + "out/m.png", 3, "out/m.png: channels: got 5, expected 1 to 4 in a .png"),
    ("PFM of 5 channels", good, TO + "out/m.pfm", 3, "out/m.pfm: channels: got 5, expected 1 or 3 in a .pfm"),
    ("json into no folder", good, MASK + " --json no/a.json", IO, "no/a.json: writing: got No such file or directory, expected"),
    ("score into no folder", scored(), "score r.vshift -o no/a.json", IO, "no/a.json: writing: got No such file or directory, expected"),
    ("over the recipe", good, TO + "r.vshift", 3, "r.vshift: ending: got .vshift, expected .exr"),
]

# -- sets ---------------------------------------------------------------------------------------------

M = r"(\./)?manifest\.json: "
MANY = "mask r.vshift --all-frames --camera * --out-dir masks/self"
RUN_JSON = "masks/self/run.json"
SETS = [
    ("score without a manifest", good, "score r.vshift", IO, M + "reading: got No such file"),
    ("all shifts without a manifest", good, MANY + " --all-shifts", IO, M + "file: got none, expected"),
    ("manifest is text", write("manifest.json", b"hello"), "score r.vshift", 3, M + "json: got .*, expected a manifest"),
    ("manifest of version 2", manifest(vshift_manifest=2), "score r.vshift", 3, M + "vshift_manifest: got .*, expected 1"),
    ("manifest nested 1M", files(lambda b: (b / "masks/self").mkdir(parents=True), write("manifest.json", b'{"vshift_manifest":1,"items":{},"x":' + nested(1000000).encode() + b"}")), MANY, 3, M + "json: got .*, expected"),
    ("manifest is a loop of links", lambda b: (b / "manifest.json").symlink_to("manifest.json"), MANY, IO, M + ".*: got Too many levels.*, expected"),
    ("manifest is a folder", lambda b: (b / "manifest.json").mkdir(), MASK, IO, M + "file: got a folder, expected"),
    ("item is text", item("done"), "check r.vshift", 3, M + "frames/0000/A.exr: .*: got .*, expected"),
    ("item's status is a number", item({"status": 1}), "check r.vshift", 3, M + "frames/0000/A.exr: .*status: got .*, expected"),
    ("item's bytes are text", item({"status": "done", "bytes": "9", "sha256": "0"}), "check r.vshift", 3, ".*frames/0000/A.exr: .*: got .*, expected"),
    ("item's sha256 is null", item({"status": "done", "bytes": 9, "sha256": None}), "check r.vshift", 3, ".*frames/0000/A.exr: .*: got .*, expected"),
    ("shifts is an object", manifest(shifts={}), MANY + " --all-shifts", 3, M + "shifts: got .*, expected a list"),
    ("shift's name climbs", manifest(shifts=[{"name": "../../x", "shift": [0, 1, 0]}]), MANY + " --all-shifts", 3, M + "shifts: got .*, expected"),
    ("shift of text", manifest(shifts=[{"name": "x", "shift": ["0", 1, 0]}]), MANY + " --all-shifts", 3, M + "shifts: got .*, expected"),
    ("shift of 1e300 m", manifest(shifts=[{"name": "x", "shift": [1e300, 1, 0]}]), MANY + " --all-shifts", 3, M + "shifts: got .*, expected"),
    ("nothing to score", manifest(), "score r.vshift", 3, r"\.?: ?masks, holes, warps: got none, expected results"),
    ("truth missing", files(scored(), lambda b: [p.unlink() for p in (b / "truth").rglob("*.exr")]), "score r.vshift", IO, r".*truth/.*A\.exr: reading: got No such file"),
    ("truth of another size", files(scored(), lambda b: exr(next((b / "truth").rglob("*.exr")), {"lost": np.zeros((5, 5))})), "score r.vshift", 3, r".*A\.exr: size: got 64x36, expected 5x5"),
    ("truth without channels", files(scored(), lambda b: exr(next((b / "truth").rglob("*.exr")), {"lost": np.zeros((HEIGHT, WIDTH))})), "score r.vshift", 3, r".*truth/.*A\.exr: channel: got .*, expected one of lost"),
    ("mask cut", files(scored(), lambda b: halve(next((b / "masks").rglob("*.exr")))), "score r.vshift", 3, r".*masks/.*A\.exr: .*: got .*, expected"),
    ("mask's count is text", scored(vshift__invalid_px="many"), "score r.vshift", 3, r".*A\.exr: vshift.invalid_px: got .*many.*, expected"),
    ("run.json is text", files(scored(), write(RUN_JSON, b"hello")), "score r.vshift", 3, r".*run\.json: .*: got .*, expected"),
    ("run.json is a number", files(scored(), write(RUN_JSON, b"5")), "score r.vshift", 3, r".*run\.json: .*: got .*, expected"),
    ("pair without truth", good, "score --got frames/0000/A.exr", 3, "usage: got .*, expected RECIPE, or --got"),
    ("pair of other sizes", lambda b: exr(b / "x.exr", {"lost": np.zeros((5, 5))}), "score --got x.exr --truth frames/0000/A.exr", 3, "x.exr: size: got 5x5, expected 64x36"),
    ("pair with nothing in common", lambda b: exr(b / "x.exr", {"lost": np.zeros((HEIGHT, WIDTH))}), "score --got x.exr --truth frames/0000/A.exr", 3, "x.exr: channels: got none in common"),
    ("report without scores", report_set, "report set.vshift", IO, r"scores/scores\.json: .*: got .*, expected"),
    ("report of broken scores", files(report_set, write("scores/scores.json", b"{")), "report set.vshift", 3, r"scores/scores\.json: json: got .*, expected valid JSON"),
    ("report without a manifest", lambda b: (b / "set.vshift").write_text(json.dumps(b.recipe)), "report set.vshift", IO, r"manifest\.json: .*: got .*, expected"),
]

TABLE = [(group, *row) for group, rows in (("recipe", RECIPE), ("request", REQUEST), ("images", IMAGES), ("outputs", OUTPUTS), ("sets", SETS))
         for row in rows]
