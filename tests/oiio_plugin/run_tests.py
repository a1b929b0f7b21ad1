#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""The plugin under the real oiiotool, iinfo, idiff and OpenImageIO's Python: all tests, or those that match.

    /usr/bin/python3 tests/oiio_plugin/run_tests.py [-v] [-k PATTERN]

support.py says which variables name the builds. The classes run side by side, as most of the time is spent in programs.
"""
import io
import os
import sys
import time
import unittest
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from support import PLUGIN, PLUGIN_DIR, SCENES, VSHIFT  # noqa: E402


def load_tests(loader, _tests, _pattern):
    return loader.discover(str(HERE), "test_*.py")


def cases(suite):
    for test in suite:
        if isinstance(test, unittest.TestSuite):
            yield from cases(test)
        else:
            yield test


class SideBySide(unittest.TextTestRunner):
    def one_class(self, tests):
        stream = io.StringIO()
        result = unittest.TextTestResult(unittest.runner._WritelnDecorator(stream), True, self.verbosity)
        unittest.TestSuite(tests).run(result)
        result.printErrors()
        return result, stream.getvalue()

    def run(self, suite):
        begin, classes = time.monotonic(), {}
        for test in cases(suite):
            classes.setdefault(type(test), []).append(test)
        longest_first = sorted(classes.values(), key=lambda tests: getattr(type(tests[0]), "about_s", len(tests)), reverse=True)
        total = self._makeResult()
        with ThreadPoolExecutor(min(4, 1 + (os.cpu_count() or 1))) as pool:
            for result, text in pool.map(self.one_class, longest_first):
                self.stream.write(text)
                total.testsRun += result.testsRun
                for kind in ("failures", "errors", "skipped", "expectedFailures", "unexpectedSuccesses"):
                    getattr(total, kind).extend(getattr(result, kind))
        for test, why in total.skipped:
            self.stream.writeln(f"\nskipped: {test}: {why}")
        counts = ", ".join(f"{kind}={len(getattr(total, kind))}" for kind in ("failures", "errors", "skipped"))
        self.stream.writeln(f"\nRan {total.testsRun} tests in {time.monotonic() - begin:.1f} s")
        self.stream.writeln(f"{'OK' if total.wasSuccessful() else 'FAILED'} ({counts})")
        return total


if __name__ == "__main__":
    for path in (PLUGIN_DIR / PLUGIN, Path(VSHIFT), Path(SCENES)):
        if not path.is_file():
            sys.exit(f"run_tests.py: {path}: got nothing, expected what the build makes")
    unittest.main(testRunner=SideBySide)
