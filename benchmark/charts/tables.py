# SPDX-License-Identifier: Apache-2.0
"""Tables of `vshift bench` as Markdown: tables.md beside its bench.json."""
from collections import defaultdict


def f1(counts):
    true_positive, wrong = counts
    return 2 * true_positive / (2 * true_positive + wrong) if true_positive + wrong else 1.0


def pooled(rows, truth):
    """F1 over the pixels of all rows."""
    return f1((sum(r[truth]["tp"] for r in rows), sum(r[truth]["fp"] + r[truth]["fn"] for r in rows)))


def mean(values):
    values = list(values)
    return sum(values) / len(values)


def table(head, rows):
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]
    return "\n".join(lines)


def grouped(rows, *keys):
    groups = defaultdict(list)
    for row in rows:
        groups[tuple(row[k] for k in keys)].append(row)
    return groups


def sources(bench):
    rows = []
    for (source, stated), group in grouped(bench["sources"], "source", "stated").items():
        flicker = [r["flicker"] for r in group if "flicker" in r]
        rows.append((source, stated, f"{pooled(group, 'shell'):.3f}",
                     f"{mean(r['shell']['boundary_f1'] for r in group):.3f}", f"{pooled(group, 'scene'):.3f}",
                     f"{mean(flicker):.2f}" if flicker else "",
                     f"{pooled([r['on_exact_depth'] for r in group], 'shell'):.3f}"))
    return table(("depth as stored", "rules for", "F1 shell", "boundary F1", "F1 scene", "flicker",
                  "the same rules on exact depth"), rows)


def edges(bench):
    def shares(rows):
        certain = sum(r["certificate"]["certain_px"] for r in rows)
        wrong = sum(r["certificate"]["wrong_occluded_px"] + r["certificate"]["wrong_visible_px"] for r in rows)
        return certain, wrong

    asked = {(r["camera"], r["shift"]) for r in bench["edges"]}
    plain = [r for r in bench["accuracy"] if r["method"] == "sweep" and (r["camera"], r["shift"]) in asked]
    rows = []
    for name, group in (("`mask`", plain), ("`mask --certify 1`", bench["edges"])):
        certain, wrong = shares(group)
        rows.append((name, f"{mean(r['certificate']['certain_share'] for r in group):.1%}",
                     f"{mean(r['edge_share'] for r in group):.1%}" if "edge_share" in group[0] else "",
                     f"{mean(r['certificate']['unknown_share'] for r in group) - mean(r.get('edge_share', 0) for r in group):.1%}",
                     f"{mean(r['certificate']['unseen_share'] for r in group):.1%}", wrong, f"{wrong / certain:.1e}"))
    return table(("", "certain", "at an edge", "unknown", "unseen", "wrong pixels", "share of the certain"), rows)


def sampling(bench):
    rows = []
    for (samples,), group in sorted(grouped(bench["sampling"], "samples_per_px").items()):
        rows.append((samples, f"{pooled(group, 'shell'):.4f}", f"{mean(r['shell']['boundary_f1'] for r in group):.4f}",
                     f"{pooled(group, 'scene'):.4f}"))
    return table(("depth samples per pixel", "F1 shell", "boundary F1", "F1 scene"), rows)


def upright(bench):
    group = [r for r in bench["accuracy"] if r["method"] == "sweep" and r["camera"] in ("CAM_FRONT", "CAM_BACK")
             and r["shift"].startswith("0,")]
    right = sum(r["shell"]["tp"] for r in group)
    wrong = sum(r["shell"]["fp"] + r["shell"]["fn"] for r in group)
    rows = [("all", wrong, "100%", f"{f1((right, wrong)):.4f}")]
    for length in group[0]["shell"]["wrong_upright_px"]:
        px = sum(r["shell"]["wrong_upright_px"][length] for r in group)
        rows.append((f"in columns of {length} and more", px, f"{px / wrong:.0%}", f"{f1((right, px)):.4f}"))
    return table(("wrong pixels", "number", "share", "F1 shell if all others were right"), rows)


def agreement(bench):
    rows = []
    for row in bench["agreement"]:
        if row["method"] != "sweep":
            continue
        rows.append((row["camera"], row["shift"], f"{row['differing_share']:.1e}", f"{row['f1']:.4f}",
                     f"{row['at_silhouette_share']:.0%}"))
    return table(("camera", "shift", "pixels that differ", "F1 between them", "of these at a silhouette"), rows)


def tiles(bench):
    meshes = {(r["method"], r["camera"], r["shift"]): r for r in bench["accuracy"]}
    rows = []
    for row in bench["agreement"]:
        if row["method"] != "embree_tiles":
            continue
        held = [meshes[(m, row["camera"], row["shift"])]["bvh_bytes"] for m in ("embree_tiles", "embree_0.02", "embree")]
        rows.append((row["camera"], row["shift"], f"{row['differing_share']:.1e}", *(f"{b / 1e6:.0f} MB" for b in held)))
    return table(("camera", "shift", "pixels that differ", "tiles hold", "collapsed mesh", "full mesh"), rows)


def carving(bench):
    alone = {(r["camera"], r["shift"]): r for r in bench["accuracy"] if r["method"] == "embree_0.02"}
    rows = []
    for row in bench["rig"]:
        self_only = alone.get((row["camera"], row["shift"]))
        if not self_only:
            continue
        own, rig = self_only["certificate"], row["certificate"]
        rows.append((row["camera"], row["shift"], f"{self_only['scene']['f1']:.3f}", f"{row['scene']['f1']:.3f}",
                     f"{row['shell_rig_limit_f1_scene']:.3f}", f"{own['unknown_share']:.1%}",
                     f"{rig['unknown_share']:.1%}", f"{own['unseen_share']:.1%}", f"{rig['unseen_share']:.1%}"))
    return table(("camera", "shift", "F1 scene, self", "rig", "the rig's limit", "unknown, self", "rig", "unseen, self",
                  "rig"), rows)


PARTS = (
    ("Depth sources", "Each source under the rules for exact depth and under its own (`depth_source`); 2 m left and 2 m "
     "ahead, three cameras. Flicker: between two draws of the noise.", sources),
    ("Certificate", "What is called certain and is wrong against the scene; 2 m left, 4 m right, 2 m ahead, three "
     "cameras.", edges),
    ("Sampling", "The same pixels answered from depth that is sampled more finely: what one sample a pixel costs, "
     "whatever the method. 2 m left and 2 m ahead, two cameras.", sampling),
    ("Upright silhouettes", "Where the sweep is wrong along rows, front and back camera: what stands upright runs along a "
     "column, and no sample tells where between two columns. Columns are of pixels that are wrong the same way.", upright),
    ("Sweep against Embree", "`occluded` of both; the picture is differences.png.", agreement),
    ("Tiles against the full mesh", "`occluded` from the height field in tiles and from the mesh of full resolution; what "
     "the ray tracer holds for the tiles, their cells included, for the mesh collapsed to 0.02 px and for the full one, "
     "without the mesh itself.", tiles),
    ("Carving", "Embree at 0.02 px from one camera and from the whole rig.", carving),
)


def write(bench, file):
    text = ["<!-- SPDX-License-Identifier: Apache-2.0 -->", "# Tables of `vshift bench`", "",
            f"Street {bench['seed']}, {bench['width']}x{bench['height']}. Shifts are x,y,z in metres: forward, left, up."]
    for title, words, rows in PARTS:
        text += ["", f"## {title}", "", words, "", rows(bench)]
    file.write_text("\n".join(text) + "\n")
