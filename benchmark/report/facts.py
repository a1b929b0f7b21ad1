# SPDX-License-Identifier: Apache-2.0
"""What the report says in words and tables: the run, the headline, the pooled rows, the commands."""
from report import pool
from report.pool import METHOD_NAME

label = pool.shift_label
KIND_NAME = {"recorded": "recorded views", "shifted": "shifted views", "truth": "truth", "mesh": "true meshes", "recipe": "recipe",
             "mask": "masks", "holes": "holes", "warp": "warps"}


def percent(value, digits=1):
    """A share as text: '12.3 %'; a dash for what is not known."""
    return "–" if value is None else f"{100 * value:.{digits}f} %"


def duration(seconds):
    """Seconds as '2 h 05 min', '3 min 20 s' or '4.2 s'."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(int(round(seconds)), 60)
    return f"{minutes} min {rest:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def number(value):
    """A number with thin spaces between thousands; texts stay as they are."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value)
    return f"{value:,}".replace(",", "\u202f") if isinstance(value, int) else f"{value:g}"


def run_facts(data):
    """Pairs of name and value: what was run, on what."""
    manifest = data["manifest"]
    street, shot, machine = manifest["street"], manifest["render"], manifest["machine"]
    pairs = [("Seed", street.get("seed", "–")), ("Detail", street.get("detail", "–")), ("Traffic", street.get("traffic", "–")),
             ("Street length", f"{street['length_m']:g} m" if isinstance(street.get("length_m"), (int, float)) else "–"),
             ("Triangles", number(street.get("triangles", "–"))), ("Geometry hash", street.get("geometry_hash", "–")),
             ("Frames", len(data["frames"])), ("Cameras", len(data["cameras"])), ("Shifts", len(data["shifts"])),
             ("Picture size", f"{shot['width']} × {shot['height']} px"), ("Samples a pixel", shot.get("samples", "–"))]
    kinds = {}
    for item in manifest["items"].values():
        if "seconds" in item:
            kind = str(item.get("kind", "other"))
            kinds[kind] = kinds.get(kind, 0.0) + item["seconds"]
    time = [(KIND_NAME.get(k, k), duration(v)) for k, v in sorted(kinds.items(), key=lambda kv: -kv[1])]
    if time:
        time.append(("all together", duration(sum(kinds.values()))))
    return {"pairs": [(k, str(v)) for k, v in pairs], "versions": [(k, str(v)) for k, v in sorted(manifest["versions"].items())],
            "machine": [(k, number(v)) for k, v in machine.items()], "time": time,
            "shifts": [(s["name"], label(s)) for s in manifest["shifts"]]}


def exceptions(data):
    """Items that were refused, moved or are still planned: dicts of path, status and reason."""
    items, out = data["manifest"]["items"], []
    for path, item in sorted(items.items()):
        moved = item["status"] == "done" and item.get("moved_to")
        twin = items.get(path.replace("truth/", "shifts/", 1)) if path.startswith("truth/") else None
        if (item["status"] == "refused" or moved) and not (twin and twin["status"] == item["status"]):
            where = ", ".join(map(str, moved)) if isinstance(moved, list) else str(moved)
            out.append({"path": path, "status": f"moved to {where} m" if moved else "refused",
                        "reason": str(item.get("reason", "no reason given"))})
    planned = sum(i["status"] == "planned" for i in items.values())
    return out, planned


def headline(data):
    """Per method, pooled over everything: F1 of lost, certificate, holes, warp."""
    scores, out = data["scores"], []
    for method in data["methods"]:
        lost = {a: pool.pool_masks(pool.select(scores["masks"], method=method, against=a, **{"class": "lost"})) for a in ("scene", "shell")}
        warp = {r: pool.pool_warps(pool.select(scores["warps"], method=method, region=r)) for r in ("seen", "all")}
        out.append({"method": method, "name": METHOD_NAME[method], "lost": lost, "warp": warp,
                    "certificate": pool.pool_certificates(pool.select(scores["certificates"], method=method)),
                    "holes": pool.pool_masks(pool.select(scores["holes"], method=method, **{"class": "hole"})),
                    "ceiling": pool.ceiling(scores, method)})
    return out


def sentences(head):
    """The headline in plain words: a list of sentences per method."""
    out = []
    for h in head:
        words = []
        scene, shell, cert, warp = h["lost"]["scene"], h["lost"]["shell"], h["certificate"], h["warp"]["seen"]
        if scene:
            words.append(f"Of every 100 pixels that are truly lost from the shifted place, it marks {100 * scene['recall']:.1f}; "
                         f"of every 100 that it marks, {100 * scene['precision']:.1f} are truly lost.")
        if shell:
            words.append(f"Against what the recording could know at all, F1 is {shell['f1']:.3f}.")
        if h["ceiling"] is not None and h["ceiling"] < .9995:
            words.append(f"{percent(1 - h['ceiling'])} of the truly occluded pixels are hidden by surfaces that the recording never saw.")
        if cert:
            words.append(f"Of every million pixels it calls certain, {number(round(cert['wrong_per_million']))} are wrong; it calls "
                         f"{percent(cert['unknown_share'])} of all pixels unknown, and {percent(cert['unseen_share'])} visible but unseen.")
        if warp:
            words.append("Where it fills the shifted view from a pixel that was really seen, the warp "
                         + ("equals the real render." if warp["equal"] else f"reaches {warp['psnr_db']:.1f} dB of the real render."))
        out.append({"name": h["name"], "method": h["method"], "text": words})
    return out


def commands(data):
    """The commands that remake the figures from the set. The manifest's own come first, where it has them."""
    given = data["manifest"].get("commands", [])
    out = [str(c) for c in given] if isinstance(given, list) else []
    for verb, folder in (("mask", "masks"), ("holes", "holes"), ("warp", "warps")):
        out += [f"vshift {verb} SET/set.vshift --camera '*' --from {method} --all-frames --all-shifts --out-dir SET/{folder}/{method}"
                for method in data["methods"]]
    return out + ["vshift score SET/set.vshift", "vshift report SET/set.vshift"]


def facts(data):
    """Everything of the page but its pictures, charts and score tables."""
    head = headline(data)
    listed, planned = exceptions(data)
    return {"name": data["folder"].resolve().name, "run": run_facts(data), "exceptions": listed, "planned": planned,
            "headline": head, "sentences": sentences(head), "commands": commands(data), "cameras": data["cameras"],
            "frames": data["frames"], "vshift": str(data["scores"].get("vshift", "–"))}


def pooled_rows(data, table, keys, pool_rows):
    """A pooled row per combination of `keys` and shift, with a row per camera below it."""
    rows, out = data["scores"][table], []
    order = {s: i for i, s in enumerate(data["shifts"])}
    labels = {s["name"]: label(s) for s in data["manifest"]["shifts"]}
    groups = {}
    for row in rows:
        groups.setdefault(tuple(row[k] for k in keys), []).append(row)
    rank = {**{name: f"{i:06d}" for name, i in order.items()}, "self": "0", "rig": "1",
            "lost": "0", "occluded": "1", "outside": "2", "hole": "0", "disoccluded": "1", "seen": "0", "all": "1"}
    for group in sorted(groups, key=lambda g: [rank.get(v, v) for v in g]):
        parent = pool_rows(groups[group])
        if parent is None:
            continue
        per_camera = [(c, pool_rows([r for r in groups[group] if r["camera"] == c])) for c in data["cameras"]]
        name = dict(zip(keys, group))
        out.append({**name, "shift_label": labels[name["shift"]], "order": order[name["shift"]], "pooled": parent,
                    "cameras": [(c, p) for c, p in per_camera if p]})
    return out


def tables(data):
    """Pooled rows of masks, of their regions, certificates, holes and warps."""
    return {"masks": pooled_rows(data, "masks", ("class", "method", "against", "shift"), pool.pool_masks),
            "mask_regions": pooled_rows(data, "mask_regions", ("region", "method", "against", "shift"), pool.pool_regions),
            "certificates": pooled_rows(data, "certificates", ("method", "shift"), pool.pool_certificates),
            "holes": pooled_rows(data, "holes", ("class", "method", "shift"), pool.pool_masks),
            "warps": pooled_rows(data, "warps", ("region", "method", "shift"), pool.pool_warps)}
