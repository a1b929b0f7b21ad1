// SPDX-License-Identifier: Apache-2.0
// Role: named tensors between safetensors files and Torch. Stage: inpaint (weights).
#pragma once
#include <functional>
#include <map>
#include <string>

#include "inpaint/torch_api.h"
#include "inpaint/wan_layout.h"

namespace vshift::inpaint {

using at::Tensor;
/// A network's parameters by Wan2.2's names.
using Weights = std::map<std::string, Tensor>;

/// The tensor `name`; throws Error our_bug when there is none.
const Tensor& get(const Weights& weights, const std::string& name);

/// A copy on the CPU, as float32.
Tensor tensor_of(const StoredTensor& stored);
/// Refers to `tensor`'s memory, which must be contiguous and on the CPU.
StoredTensor stored_of(const std::string& name, const Tensor& tensor);

/// All of a layout, as float32. Throws as require_layout does.
Weights load_weights(const TensorFiles& files, const Layout& layout, Network network);

/// Of a model that vshift trained, by the metadata's "config"; throws Error bad_input, saying which `command` makes one.
const std::string& trained_config(const TensorFiles& files, const std::string& command);
/// Groups of a trained model's tensors, by the prefix of their names in the file.
using Groups = std::map<std::string, Layout>;
/// All of them, as float32, and no other tensor is there: Error bad_input names what does not fit.
std::map<std::string, Weights> trained_weights(const TensorFiles& files, const Groups& groups);
/// Writes them, with `config` among the metadata.
void write_trained(const std::filesystem::path& file, const std::map<std::string, const Weights*>& groups,
                   std::map<std::string, std::string> metadata, const std::string& config);

/// hash_of over the weights as they are.
uint64_t hash_of(const Weights& weights);

/// Fresh weights: matrices uniform in +-sqrt(3 / fan in), biases 0, norms 1, modulations small; `zero(name)` says what
/// begins at 0, such as the output, so that training begins at the fill. Same seed, same numbers on every Torch.
Weights initial_weights(const Layout& layout, uint64_t seed, const std::function<bool(const std::string&)>& zero);
Weights initial_dit(const DitConfig& config, uint64_t seed);  ///< head.head at 0

/// The same network with more input channels (paper III-E): what was there is copied bit for bit and stays first, new
/// channels are Kaiming-uniform (or 0). `config` is changed along.
void widen_input(Weights& weights, DitConfig& config, int64_t in_channels, uint64_t seed, bool zero = false);

}  // namespace vshift::inpaint
