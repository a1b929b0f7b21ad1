// SPDX-License-Identifier: Apache-2.0
// Role: which tensors Wan2.2's DiT and VAE have at any size, in its own and in Diffusers' names. Stage: inpaint.
// No Torch here: a checkpoint of 5 billion parameters is checked from its headers, before anything is loaded.
#pragma once
#include <array>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "inpaint/tensor_file.h"

namespace vshift::inpaint {

/// The transformer (paper III-E). Defaults: Wan2.2 TI2V-5B.
struct DitConfig {
    int64_t in_channels = 48;   ///< noisy latent, then condition, then any further channels
    int64_t out_channels = 48;  ///< the velocity
    int64_t dim = 3072;
    int64_t ffn_dim = 14336;
    int64_t layers = 30;
    int64_t heads = 24;
    int64_t freq_dim = 256;              ///< of the time's sinusoids
    int64_t text_dim = 4096;             ///< 0: no text, and then no cross-attention
    int64_t text_len = 512;              ///< the text is padded with zeros to this length
    std::array<int64_t, 3> patch{1, 2, 2};  ///< frames, rows, columns of latents in a token
    int64_t reach = 0;  ///< a token attends to those fewer than this many rows and columns away; 0: to all, as Wan2.2
    double eps = 1e-6;
};

/// The causal video autoencoder, 4 frames x 16 x 16 pixels to a latent. Defaults: Wan2.2's.
struct VaeConfig {
    int64_t dim = 160;      ///< encoder's base width
    int64_t dec_dim = 256;  ///< decoder's
    int64_t z_dim = 48;
    std::vector<int64_t> dim_mult{1, 2, 4, 4};
    int64_t res_blocks = 2;
    std::vector<bool> temporal_down{false, true, true};  ///< by level: halves time too
    std::vector<float> mean, std;                        ///< of the latents; empty: 0 and 1
};

/// From JSON of these field names, absent ones at their defaults. Throws Error bad_input for unknown fields, wrong
/// types, and sizes out of range or that do not fit each other; `where` begins the message.
DitConfig parse_dit_config(const nlohmann::json& json, const std::string& where);
VaeConfig parse_vae_config(const nlohmann::json& json, const std::string& where);
nlohmann::ordered_json json_of(const DitConfig& config);
nlohmann::ordered_json json_of(const VaeConfig& config);

/// Name (Wan2.2's own) to shape.
using Layout = std::map<std::string, Shape>;
Layout dit_layout(const DitConfig& config);
Layout vae_layout(const VaeConfig& config);

/// Wan2.2's own name for one that Diffusers uses, and back. Names of neither come back unchanged.
std::string dit_name_from_diffusers(const std::string& name);
std::string dit_name_to_diffusers(const std::string& name);
std::string vae_name_from_diffusers(const std::string& name);
std::string vae_name_to_diffusers(const std::string& name);

/// The tensors of `files` by Wan2.2's own names, whichever of the two sets of names they bear. Throws Error bad_input
/// that names the first missing, extra or misshapen tensor and says how many there are of each, or that is no float.
enum class Network { dit, vae };
std::map<std::string, StoredTensor> require_layout(const TensorFiles& files, const Layout& expected, Network network);

}  // namespace vshift::inpaint
