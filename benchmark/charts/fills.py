# SPDX-License-Identifier: Apache-2.0
"""The chart of the fills without a network: fills.{svg,png} from the scores of one set or several, and their table.

    /usr/bin/python3 benchmark/charts/fills.py SET_DIR... [-o DIR]
"""
import argparse
import json
import sys
from pathlib import Path

import matplotlib
matplotlib.use("agg")
from matplotlib import pyplot as plt  # noqa: E402

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from report import fills  # noqa: E402

STYLE = {"svg.hashsalt": "vshift", "font.size": 10, "axes.grid": True, "grid.color": "#dddddd", "grid.linewidth": .6,
         "axes.axisbelow": True, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False,
         "axes.titlesize": 11, "axes.titleweight": "bold", "figure.facecolor": "white"}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", type=Path, nargs="+")
    parser.add_argument("-o", "--out", type=Path, default=Path("docs/figures"))
    args = parser.parse_args()
    scores = fills.pooled([json.loads((folder / "scores" / "scores.json").read_text()) for folder in args.sets])
    print(fills.markdown(scores))
    with plt.rc_context(STYLE):
        figure = fills.draw(plt, scores)
        if figure is None:
            print("fills: scores: got no filled views with times, expected those of vshift inpaint", file=sys.stderr)
            return 3
        for kind in ("svg", "png"):
            figure.savefig(args.out / f"fills.{kind}", bbox_inches="tight", dpi=140, metadata={"Date": None} if kind == "svg" else None)
    print(args.out / "fills.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
