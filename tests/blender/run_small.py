# SPDX-License-Identifier: GPL-3.0-or-later
"""blender_addon/run.py over the small street: blender -b ... -P tests/blender/run_small.py -- set ..."""
import runpy
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "blender_addon"), str(ROOT / "tests" / "blender")]

import small_street  # noqa: E402

small_street.install()
runpy.run_path(str(ROOT / "blender_addon" / "run.py"), run_name="__main__")
