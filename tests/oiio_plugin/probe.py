# SPDX-License-Identifier: Apache-2.0
"""Opens images through OpenImageIO's Python API and prints, as JSON, what each subimage is.

    probe.py '{"names": [...], "threads": 1, "config": {}, "pixels": true}'

`threads` opens the whole list in each of so many threads. An image that does not open gives {"error": reason}; a reason
that Python cannot take, as it is no UTF-8, gives {"exception": why}.
"""
import hashlib
import json
import sys
import threading

import OpenImageIO as oiio

MOST_SUBIMAGES = 64


def look(name, config, with_pixels):
    image = oiio.ImageInput.open(name, config) if config else oiio.ImageInput.open(name)
    if image is None:
        return {"error": oiio.geterror()}
    parts = []
    while len(parts) < MOST_SUBIMAGES and image.seek_subimage(len(parts), 0):
        spec = image.spec()
        part = {"width": spec.width, "height": spec.height, "channels": list(spec.channelnames), "type": str(spec.format),
                "tile": spec.tile_width, "attributes": {a.name: a.value for a in spec.extra_attribs}}
        if with_pixels:
            data = image.read_image("float")
            if data is None:
                return {"error": image.geterror()}
            part["sha256"] = hashlib.sha256(data.tobytes()).hexdigest()
        parts.append(part)
    image.close()
    return {"format": image.format_name(), "subimages": parts}


def guarded(*words):
    try:
        return look(*words)
    except Exception as e:
        return {"exception": repr(e)}


def main():
    options = json.loads(sys.argv[1])
    config = None
    if options.get("config"):
        config = oiio.ImageSpec()
        for key, value in options["config"].items():
            config.attribute(key, value)
    # The binding sets itself up on its first array, and hangs when eight threads do that at once.
    oiio.ImageBuf(oiio.ImageSpec(1, 1, 1, "float")).get_pixels("float")
    count = options.get("threads", 1)
    results = [None] * count
    start = threading.Barrier(count)

    def work(i):
        start.wait()
        results[i] = [guarded(name, config, options.get("pixels", True)) for name in options["names"]]

    threads = [threading.Thread(target=work, args=(i,)) for i in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    json.dump(results[0] if count == 1 else results, sys.stdout, default=list)


main()
