# SPDX-License-Identifier: Apache-2.0
"""Compares the networks with Diffusers' own classes. For developers: needs torch, diffusers and safetensors.

    python compare_diffusers.py build/bin/vshift_network_tests          random weights both ways
    python compare_diffusers.py --fixtures tests/inpaint/fixtures       writes the committed VAE data anew
"""
import argparse
import os
import subprocess
import sys
import tempfile

try:
    import torch
    from diffusers import AutoencoderKLWan, WanTransformer3DModel
    from safetensors.torch import save_file
except ImportError as e:
    print(f"skipped: {e} (pip install torch diffusers safetensors)")
    sys.exit(0)


def randomise(model, seed):
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for name, p in model.named_parameters():
            noise = torch.randn(p.shape, generator=generator)
            if "gamma" in name or ("norm" in name and name.endswith("weight")):
                p.copy_(1 + 0.1 * noise)
            else:
                p.copy_(noise / max(1.0, (p.numel() / p.shape[0]) ** 0.5))


def write_vae(folder):
    vae = AutoencoderKLWan(base_dim=4, decoder_base_dim=4, z_dim=3, dim_mult=[1, 2, 4, 4], num_res_blocks=1,
                           temperal_downsample=[False, True, True], latents_mean=[0.1, -0.2, 0.3],
                           latents_std=[0.5, 1.0, 1.5], is_residual=True, in_channels=12, out_channels=12, patch_size=2,
                           scale_factor_spatial=16).eval()
    randomise(vae, 2)
    with torch.no_grad():
        for p in vae.decoder.conv_out.parameters():  # few values beyond the clamp
            p.mul_(0.2)
    video = torch.rand(1, 3, 9, 32, 48, generator=torch.Generator().manual_seed(3)) * 2 - 1
    mean = torch.tensor(vae.config.latents_mean)
    std = torch.tensor(vae.config.latents_std)
    with torch.no_grad():
        z = (vae.encode(video).latent_dist.mode() - mean.view(1, -1, 1, 1, 1)) / std.view(1, -1, 1, 1, 1)
        r = vae.decode(z * std.view(1, -1, 1, 1, 1) + mean.view(1, -1, 1, 1, 1)).sample
    save_file({k: v.contiguous() for k, v in vae.state_dict().items()}, os.path.join(folder, "vae_small.safetensors"))
    save_file({"vid": video, "z": z.contiguous(), "r": r.contiguous(), "mean": mean, "std": std},
              os.path.join(folder, "vae_small_io.safetensors"))


def write_dit(folder):
    dit = WanTransformer3DModel(patch_size=(1, 2, 2), num_attention_heads=2, attention_head_dim=24, in_channels=8,
                                out_channels=4, text_dim=20, freq_dim=32, ffn_dim=96, num_layers=2,
                                cross_attn_norm=True).eval()
    randomise(dit, 1)
    generator = torch.Generator().manual_seed(4)
    x = torch.randn(1, 8, 3, 6, 10, generator=generator)
    words = torch.randn(1, 7, 20, generator=generator)
    padded = torch.cat([words, torch.zeros(1, 5, 20)], 1)
    t = torch.cat([torch.zeros(15), torch.full((30,), 713.0)]).view(1, 45)
    with torch.no_grad():
        y = dit(x, t, padded, return_dict=False)[0]
        y1 = dit(x, torch.tensor([250.0]), padded, return_dict=False)[0]
    save_file({k: v.contiguous() for k, v in dit.state_dict().items()}, os.path.join(folder, "dit.safetensors"))
    save_file({"x": x[0], "t": t[0], "ctx": words[0], "y": y[0].contiguous(), "y1": y1[0].contiguous()},
              os.path.join(folder, "dit_io.safetensors"))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("program", nargs="?")
    parser.add_argument("--fixtures")
    options = parser.parse_args()
    if options.fixtures:
        write_vae(options.fixtures)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        write_vae(folder)
        write_dit(folder)
        return subprocess.run([options.program, "[diffusers]"], env={**os.environ, "VSHIFT_DIFFUSERS_DIR": folder}).returncode


if __name__ == "__main__":
    sys.exit(main())
