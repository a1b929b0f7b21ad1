# SPDX-License-Identifier: GPL-3.0-or-later
"""blender -b --factory-startup --python-exit-code 3 -P tests/blender/run_tests.py [-- unittest arguments]"""
import os
import sys
import unittest
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "blender_addon"), str(ROOT / "tests" / "blender")]

if __name__ == "__main__":
    words = sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else []
    program = unittest.main(module="test_addon", argv=["test_addon", *words], exit=False, verbosity=2)
    good = program.result.wasSuccessful() and program.result.testsRun > 0
    print("test_addon:", "passed" if good else "FAILED", flush=True)
    sys.stderr.flush()
    os._exit(0 if good else 1)
