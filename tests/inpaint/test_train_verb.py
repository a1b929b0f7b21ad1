# SPDX-License-Identifier: Apache-2.0
"""vshift train as a user runs it: it learns, goes on after a kill with the same bytes, and refuses what it should."""
import json
import os
import resource
import signal
import struct
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path

VSHIFT = os.environ["VSHIFT_BIN"]
HAS_NETWORK = os.environ["VSHIFT_HAS_TORCH"] == "ON"
SMALL = {"--streets": "1", "--frames": "1", "--width": "96", "--batch": "2", "--learning-rate": "2e-3", "--threads": "1"}


def small(**other):
    """Options, `steps=3` standing for --steps 3."""
    options = {**SMALL, **{"--" + key.replace("_", "-"): value for key, value in other.items()}}
    return [word for key, value in options.items() for word in ([key] if value is True else [key, str(value)])]


def run(*words, timeout=120, **settings):
    return subprocess.run([VSHIFT, *words], env={**os.environ, **settings}, capture_output=True, text=True, timeout=timeout)


def header(file):
    data = Path(file).read_bytes()
    return json.loads(data[8:8 + struct.unpack("<Q", data[:8])[0]])


class WithoutNetwork(unittest.TestCase):
    def test_missing_library_is_named(self):
        done = run("train", "-o", "x.safetensors", VSHIFT_INPAINT_LIBRARY="/nowhere/libvshift_inpaint.so")
        self.assertEqual(done.returncode, 4)
        self.assertEqual(len(done.stderr.strip().splitlines()), 1)
        self.assertIn("libtorch-dev", done.stderr)

    def test_program_does_not_load_torch(self):
        needed = subprocess.run(["ldd", VSHIFT], capture_output=True, text=True).stdout
        self.assertIn("libembree", needed)
        self.assertNotIn("torch", needed)
        self.assertNotIn("OpenImageIO", needed)  # 240 ms
        start = min(self.cpu_seconds_of_start() for _ in range(5))
        print(f"vshift --version: {start * 1000:.0f} ms of CPU", file=sys.stderr)
        self.assertLess(start, 0.1)

    def cpu_seconds_of_start(self):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        self.assertEqual(run("--version").returncode, 0)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


@unittest.skipUnless(HAS_NETWORK, "built without LibTorch")
class Train(unittest.TestCase):
    def setUp(self):
        self.scratch = tempfile.TemporaryDirectory()
        self.addCleanup(self.scratch.cleanup)
        self.folder = Path(self.scratch.name)

    def words(self, name, **options):
        return ["train", "-o", str(self.folder / name), *small(**options)]

    def train(self, name, **options):
        return run(*self.words(name, **options))

    def test_learns_and_says_how(self):
        done = self.train("m.safetensors", steps=60, ema=.9, judge=101)
        self.assertEqual(done.returncode, 0, done.stderr)
        rows = [line.split(",") for line in (self.folder / "m.curve.csv").read_text().splitlines()]
        self.assertEqual(rows[0], ["step", "loss", "learning_rate"])
        losses = [float(r[1]) for r in rows[1:]]
        self.assertEqual(len(losses), 60)
        self.assertLess(sum(losses[-15:]), 0.9 * sum(losses[:15]))
        self.assertEqual((self.folder / "m.curve.png").read_bytes()[:8], b"\x89PNG\r\n\x1a\n")
        self.assertFalse((self.folder / "m.checkpoint.safetensors").exists())
        metadata = header(self.folder / "m.safetensors")["__metadata__"]
        self.assertEqual(json.loads(metadata["config"])["kind"], "pixel_unet")
        self.assertEqual(metadata["license"], "Apache-2.0")
        record = json.loads(metadata["training"])
        self.assertEqual((record["steps"], record["streets"]), (60, "1"))
        judged = json.loads((self.folder / "m.judge.json").read_text())
        fills = ["background", "pushpull", "telea", "ns"]
        for size in (0, 1, 2, 4):
            rows = {r["way"]: r for r in judged["ways"] if r["shift_m"] == size}
            self.assertEqual(list(rows), [*fills, "m"])
            best = max(fills, key=lambda f: rows[f]["psnr_db"])
            for r in rows.values():
                self.assertTrue(5 < r["psnr_db"] < 40)
                self.assertEqual(r["best_fill"], best)
                self.assertAlmostEqual(r["gain_db"], r["psnr_db"] - rows[best]["psnr_db"], 9)
                self.assertIsNone(r["gain_db_95"])  # one street
                self.assertTrue(r["texture_distance"] > 0 and r["gradient_share"] > 0 and r["cpu_ms"] > 0)

    def test_goes_on_after_a_kill(self):
        self.goes_on_after_a_kill(steps=40, checkpoint_every=7, flow=True)
        # Interrupted by a user: a checkpoint, and exit code 130.
        running = subprocess.Popen([VSHIFT, *self.words("c.safetensors", steps=100000)], stdout=subprocess.DEVNULL,
                                   stderr=subprocess.PIPE, text=True)
        for line in running.stderr:
            if line.startswith("train"):
                break
        running.send_signal(signal.SIGINT)
        running.communicate()
        self.assertEqual(running.returncode, 130)
        self.assertTrue((self.folder / "c.checkpoint.safetensors").exists())
        self.assertFalse((self.folder / "c.safetensors").exists())

    def test_a_flow_begins_with_rays(self):
        done = self.train("rays.safetensors", kind="pixel_rays", steps=5, pairs=4)
        self.assertEqual(done.returncode, 0, done.stderr)
        start = self.folder / "rays.safetensors"
        self.goes_on_after_a_kill(steps=40, checkpoint_every=7, flow=True, start=start, crop=32)
        metadata = header(self.folder / "a.safetensors")["__metadata__"]
        config = json.loads(metadata["config"])
        self.assertEqual((config["start"]["coupling"] < 1, config["rays"]["detail"]), (True, 1.1))
        self.assertEqual(json.loads(metadata["start_training"])["steps"], 5)
        headers = [header(file) for file in (start, self.folder / "a.safetensors")]  # the rays are in it, as they were
        for name, entry in headers[0].items():
            if name != "__metadata__":
                inside = headers[1][name.replace("network.", "start.")]
                self.assertEqual(self.tensor("rays.safetensors", entry), self.tensor("a.safetensors", inside), name)
        for options, part in (({"start": start}, "config: start"), ({"flow": True, "start": self.folder / "a.safetensors"}, "a pixel_rays")):
            done = self.train("r.safetensors", steps=1, **options)
            self.assertEqual(done.returncode, 3, done.stderr)
            self.assertIn(part, done.stderr.splitlines()[-1])

    def goes_on_after_a_kill(self, **options):
        straight = self.train("a.safetensors", **options)
        self.assertEqual(straight.returncode, 0, straight.stderr)
        words = [VSHIFT, *self.words("b.safetensors", **options)]
        running = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        checkpoint = self.folder / "b.checkpoint.safetensors"
        end = time.monotonic() + 60
        while not checkpoint.exists() and running.poll() is None and time.monotonic() < end:
            time.sleep(0.001)
        running.send_signal(signal.SIGKILL)
        running.wait()
        self.assertEqual(running.returncode, -signal.SIGKILL)
        step = int(header(checkpoint)["__metadata__"]["step"])
        self.assertTrue(0 < step < 40, step)
        again = subprocess.run(words, capture_output=True, text=True)
        self.assertEqual(again.returncode, 0, again.stderr)
        tensors = [Path(self.folder / f).read_bytes() for f in ("a.safetensors", "b.safetensors")]
        data = [t[8 + struct.unpack("<Q", t[:8])[0]:] for t in tensors]
        self.assertEqual(data[0], data[1])
        self.assertEqual((self.folder / "a.curve.csv").read_text(), (self.folder / "b.curve.csv").read_text())

    def test_latents_and_arms(self):
        tiny = self.folder / "tiny.json"
        tiny.write_text('{"vae": {"dim": 4, "dec_dim": 4, "z_dim": 4, "dim_mult": [1, 1], "res_blocks": 1, "temporal_down": [false]}}')
        done = self.train("vae.safetensors", kind="autoencoder", config=tiny, steps=30, crop=32, judge=101)
        self.assertEqual(done.returncode, 0, done.stderr)
        metadata = header(self.folder / "vae.safetensors")["__metadata__"]
        self.assertTrue(5 < json.loads(metadata["training"])["reconstruction_db"] < 60)
        self.assertEqual(len(json.loads(metadata["config"])["vae"]["std"]), 4)
        tiny.write_text('{"dit": {"dim": 16, "ffn_dim": 16, "layers": 1, "heads": 2, "freq_dim": 8, "text_dim": 0, "patch": [1, 2, 2], "reach": 3}}')
        done = self.train("latent.safetensors", kind="latent_dit", flow=True, autoencoder=self.folder / "vae.safetensors",
                          config=tiny, steps=3, crop=32, arm="seam", judge=101, judge_also=self.folder / "latent.safetensors",
                          euler_steps="1,2")
        self.assertEqual(done.returncode, 0, done.stderr)
        judged = json.loads((self.folder / "latent.judge.json").read_text())
        self.assertEqual([r["way"] for r in judged["ways"] if r["shift_m"] == 0][4:],
                         ["seam+background", *["latent, 1 step", "latent, 2 steps"] * 2])
        # The autoencoder is in the model as it was.
        files = ("vae.safetensors", "latent.safetensors")
        tensors = [{k: v for k, v in header(self.folder / f).items() if k.startswith("vae.")} for f in files]
        self.assertEqual(sorted(tensors[0]), sorted(tensors[1]))
        for name in tensors[0]:
            self.assertEqual(*(self.tensor(f, t[name]) for f, t in zip(files, tensors)), name)
        done = self.train("vae.safetensors", judge_only=True, judge=101)
        self.assertEqual(done.returncode, 3)
        self.assertIn("expected a model that fills", done.stderr)
        self.latents_begin_with_weights_of_others()

    def latents_begin_with_weights_of_others(self):
        """The same networks as Wan2.2's files have them: without config, one file for each."""
        trained = header(self.folder / "latent.safetensors")
        config = json.loads(trained.pop("__metadata__")["config"])
        for prefix, file in (("network.", "dit.safetensors"), ("vae.", "wan_vae.safetensors")):
            own, data = {}, b""
            for name, entry in trained.items():
                if name.startswith(prefix):
                    values = self.tensor("latent.safetensors", entry)
                    own[name[len(prefix):]] = {**entry, "data_offsets": [len(data), len(data) + len(values)]}
                    data += values
            head = json.dumps(own).encode()
            (self.folder / file).write_bytes(struct.pack("<Q", len(head)) + head + data)
        given = self.folder / "wan.json"
        for vae, code in ({key: value for key, value in config["vae"].items() if key != "mean"}, 3), (config["vae"], 0):
            given.write_text(json.dumps({"dit": config["dit"], "vae": vae}))
            done = self.train("of_wan.safetensors", kind="latent_dit", flow=True, autoencoder=self.folder / "wan_vae.safetensors",
                              dit=self.folder / "dit.safetensors", config=given, steps=1, crop=32, learning_rate=0)
            self.assertEqual(done.returncode, code, done.stderr)
            if code:
                self.assertIn("mean, std: got 0 and 4", done.stderr)
        got = header(self.folder / "of_wan.safetensors")
        metadata = got.pop("__metadata__")
        self.assertFalse(json.loads(metadata["config"])["gives_data"])
        self.assertEqual(json.loads(metadata["training"])["begins_with"], "dit.safetensors")
        self.assertEqual(sorted(got), sorted(trained))
        for name in trained:
            self.assertEqual(self.tensor("of_wan.safetensors", got[name]), self.tensor("latent.safetensors", trained[name]), name)

    def tensor(self, file, entry):
        data = (self.folder / file).read_bytes()
        begin, end = (8 + struct.unpack("<Q", data[:8])[0] + o for o in entry["data_offsets"])
        return data[begin:end]

    def test_one_command_one_file(self):
        files = []
        for name in ("a.safetensors", "b.safetensors"):
            done = self.train(name, kind="pixel_rays", steps=40, pairs=12)
            self.assertEqual(done.returncode, 0, done.stderr)
            files.append((self.folder / name).read_bytes())
        self.assertEqual(files[0], files[1])
        rows = [float(line.split(",")[1]) for line in (self.folder / "a.curve.csv").read_text().splitlines()[1:]]
        self.assertLess(sum(rows[-8:]), 0.9 * sum(rows[:8]))
        # How much texture it adds in filling is no matter of training.
        (self.folder / "detail.json").write_text('{"rays": {"detail": 1.1}}')
        done = self.train("d.safetensors", kind="pixel_rays", steps=40, pairs=12, config=self.folder / "detail.json")
        self.assertEqual(done.returncode, 0, done.stderr)
        headers = [header(self.folder / name) for name in ("a.safetensors", "d.safetensors")]
        self.assertEqual(json.loads(headers[1]["__metadata__"]["config"])["rays"]["detail"], 1.1)
        for name in set(headers[0]) - {"__metadata__"}:
            self.assertEqual(self.tensor("a.safetensors", headers[0][name]), self.tensor("d.safetensors", headers[1][name]), name)
        other = self.train("c.safetensors", kind="pixel_rays", steps=5, pairs=12, seed=2)
        self.assertEqual(other.returncode, 0, other.stderr)
        self.assertNotEqual((self.folder / "c.safetensors").read_bytes(), files[0])

    def test_bf16_stays_near_float32(self):
        losses = {}
        for name in ("float32", "bf16"):
            done = self.train(f"{name}.safetensors", steps=16, crop=48, precision=name, device="cpu")
            self.assertEqual(done.returncode, 0, done.stderr)
            losses[name] = [float(line.split(",")[1]) for line in (self.folder / f"{name}.curve.csv").read_text().splitlines()[1:]]
            self.assertEqual(json.loads(header(self.folder / f"{name}.safetensors")["__metadata__"]["training"]).get("precision", "float32"), name)
        self.assertNotEqual(losses["bf16"], losses["float32"])
        for bf16, float32 in zip(*losses.values()):
            self.assertAlmostEqual(bf16 / float32, 1, delta=0.1)

    def small_set(self, name, *words):
        """Trains and judges on a tiny set: the loss of the first and last 20 steps, and the judge's rows by (way, shift)."""
        done = run("train", "-o", str(self.folder / f"{name}.safetensors"), "--frames", "1", "--lanes-m", "4", "--width", "160", "--batch", "4",
                   "--learning-rate", "2e-3", "--ema", "0.98", "--threads", "1", "--judge", "101-102", *words, timeout=600)
        self.assertEqual(done.returncode, 0, done.stderr)
        losses = [float(line.split(",")[1]) for line in (self.folder / f"{name}.curve.csv").read_text().splitlines()[1:]]
        ways = json.loads((self.folder / f"{name}.judge.json").read_text())["ways"]
        self.assertEqual(sorted({r["shift_m"] for r in ways}), [0, 1, 2, 4])
        first, last, rows = sum(losses[:20]) / 20, sum(losses[-20:]) / 20, {(r["way"], r["shift_m"]): r for r in ways}
        print(f"{name}: loss {first:.3f} to {last:.3f};", *(f"{way}, {size:.0f} m: {r['gain_db']:+.2f} dB, texture {r['texture_distance']:.2f};"
              for (way, size), r in rows.items() if way.startswith(name) or way == "background"), file=sys.stderr)
        return first, last, rows

    # Both together train and judge for a minute of one core.
    def test_a_small_set_is_enough_to_beat_every_fill_elsewhere(self):
        first, last, rows = self.small_set("rays", "--kind", "pixel_rays", "--streets", "1-8", "--pairs", "350", "--steps", "600")
        self.assertLess(last, 0.7 * first)
        for size in (0, 1, 2, 4):
            self.assertGreater(rows["rays", size]["gain_db"], 0.3 if size == 0 else 0.1, f"{size} m")

    def test_a_small_flow_goes_to_the_data(self):
        # Too little to gain in PSNR, but nearer to the truth's texture than the fill that it begins at. Noise that was left, or that
        # the wrong sign adds, has a standard deviation of 1/4: 12 dB, where the fill has 17.
        first, last, rows = self.small_set("flow", "--kind", "pixel_unet", "--flow", "--streets", "1-4", "--crop", "64", "--steps", "150",
                                           "--euler-steps", "1,2")
        self.assertLess(last, 0.8 * first)
        for size in (0, 1, 2, 4):
            fill = rows["background", size]
            for way in ("flow, 1 step", "flow, 2 steps"):
                r = rows[way, size]
                self.assertGreater(r["gain_db"], -1.5, (way, size))
                self.assertLess(r["texture_distance"], fill["texture_distance"], (way, size))

    def test_refuses(self):
        for options, code, part in (
                ({"streets": "5-1"}, 3, "expected seeds"),
                ({"judge": "1"}, 3, "trained on"),
                ({"kind": "latent_dit"}, 3, "--autoencoder"),
                ({"dit": "x.safetensors"}, 3, "--dit"),
                ({"kind": "autoencoder"}, 3, "--judge"),
                ({"arm": "sem"}, 3, "nearest: seam"),
                ({"kind": "cubic"}, 3, "pixel_unet"),
                ({"lanes_m": 5}, 3, "--lanes-m"),
                ({"steps": 0}, 3, "steps"),
                ({"stepz": 1}, 3, "--steps"),
                ({"device": "cuda:0"}, 3, "expected cpu or cuda"),
                ({"precision": "half"}, 3, "float32 or bf16"),
                *([] if Path("/dev/nvidiactl").exists() else [({"device": "cuda"}, 3, "device: got cuda, expected cpu")]),
                ({"config": "/nowhere.json"}, 4, "/nowhere.json")):
            done = self.train("r.safetensors", **{"steps": 1, **options})
            self.assertEqual(done.returncode, code, (options, done.stderr))
            self.assertIn(part, done.stderr.splitlines()[-1])
        self.assertEqual(list(self.folder.glob("r.*")), [])
        (self.folder / "p.safetensors").write_bytes(b"\x80\x02}q\x01." + b"\0" * 40)
        done = self.train("p.safetensors", judge_only=True, judge=101)
        self.assertEqual(done.returncode, 3)
        self.assertIn("pickle", done.stderr)


if __name__ == "__main__":
    unittest.main(verbosity=2)
