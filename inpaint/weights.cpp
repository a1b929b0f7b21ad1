// SPDX-License-Identifier: Apache-2.0
#include "inpaint/weights.h"

#include <cmath>
#include <cstring>

namespace vshift::inpaint {
namespace {

at::ScalarType type_of(ElementType type) {
    switch (type) {
        case ElementType::boolean: return at::kBool;
        case ElementType::u8: return at::kByte;
        case ElementType::i8: return at::kChar;
        case ElementType::i16: return at::kShort;
        case ElementType::i32: return at::kInt;
        case ElementType::i64: return at::kLong;
        case ElementType::f16: return at::kHalf;
        case ElementType::bf16: return at::kBFloat16;
        case ElementType::f32: return at::kFloat;
        case ElementType::f64: return at::kDouble;
    }
    throw Error(ExitCode::our_bug, "tensor: got an unknown element type, expected a known one");
}

ElementType element_of(at::ScalarType type) {
    for (int i = 0; i <= int(ElementType::f64); ++i)
        if (type_of(ElementType(i)) == type) return ElementType(i);
    throw Error(ExitCode::our_bug, std::string("tensor: got type ") + at::toString(type) + ", expected one of a file's");
}

[[noreturn]] void refuse(const std::string& what, const std::string& got, const std::string& expected) {
    throw Error(ExitCode::bad_input, what + ": got " + got + ", expected " + expected);
}

/// Uniform in +-bound by a generator of our own, so that every Torch gives the same numbers.
void fill_uniform(Tensor& t, double bound, uint64_t& state) {
    float* data = t.data_ptr<float>();
    for (int64_t i = 0; i < t.numel(); ++i) {
        state += 0x9e3779b97f4a7c15ull;  // splitmix64
        uint64_t z = state;
        z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
        z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
        z ^= z >> 31;
        data[i] = float((double(z >> 11) / 9007199254740992.0 * 2 - 1) * bound);
    }
}

}  // namespace

const Tensor& get(const Weights& weights, const std::string& name) {
    const auto at = weights.find(name);
    if (at == weights.end()) throw Error(ExitCode::our_bug, "weights: got no " + name + ", expected it");
    return at->second;
}

Tensor tensor_of(const StoredTensor& stored) {
    Tensor t = at::empty(stored.shape, at::TensorOptions().dtype(type_of(stored.type)));
    if (stored.bytes) std::memcpy(t.data_ptr(), stored.data, stored.bytes);
    return stored.type == ElementType::f32 ? t : t.to(at::kFloat);
}

StoredTensor stored_of(const std::string& name, const Tensor& tensor) {
    if (!tensor.is_contiguous() || !tensor.device().is_cpu())
        throw Error(ExitCode::our_bug, "tensor " + name + ": got a view or device memory, expected contiguous");
    StoredTensor s;
    s.name = name;
    s.type = element_of(tensor.scalar_type());
    s.shape = Shape(tensor.sizes().begin(), tensor.sizes().end());
    s.data = static_cast<const uint8_t*>(tensor.data_ptr());
    s.bytes = size_t(tensor.numel()) * bytes_of(s.type);
    return s;
}

Weights load_weights(const TensorFiles& files, const Layout& layout, Network network) {
    Weights out;
    for (const auto& [name, stored] : require_layout(files, layout, network)) out[name] = tensor_of(stored);
    return out;
}

uint64_t hash_of(const Weights& weights) {
    std::vector<Tensor> kept;
    std::vector<StoredTensor> stored;
    for (const auto& [name, t] : weights) {
        kept.push_back(t.detach().cpu().contiguous());
        stored.push_back(stored_of(name, kept.back()));
    }
    return hash_of(std::move(stored));
}

const std::string& trained_config(const TensorFiles& files, const std::string& command) {
    const auto config = files.metadata().find("config");
    if (config == files.metadata().end())
        refuse(files.file() + ": config", "none in the metadata", "a model of " + command);
    return config->second;
}

std::map<std::string, Weights> trained_weights(const TensorFiles& files, const Groups& groups) {
    std::map<std::string, Weights> out;
    size_t count = 0;
    for (const auto& [prefix, layout] : groups)
        for (const auto& [name, shape] : layout) {
            const StoredTensor* t = files.find(prefix + name);
            if (!t) refuse(files.file() + ": " + prefix + name, "none", "a tensor of shape " + text_of(shape));
            if (t->shape != shape) refuse(files.file() + ": " + t->name, "shape " + text_of(t->shape), text_of(shape));
            if (t->type < ElementType::f16) refuse(files.file() + ": " + t->name, name_of(t->type), "a float type");
            out[prefix][name] = tensor_of(*t);
            ++count;
        }
    if (files.tensors().size() != count)
        refuse(files.file() + ": tensors", std::to_string(files.tensors().size()), std::to_string(count) + " of the config");
    return out;
}

void write_trained(const std::filesystem::path& file, const std::map<std::string, const Weights*>& groups,
                   std::map<std::string, std::string> metadata, const std::string& config) {
    std::vector<Tensor> kept;
    std::vector<StoredTensor> stored;
    for (const auto& [prefix, weights] : groups)
        for (const auto& [name, t] : *weights) {
            kept.push_back(t.detach().cpu().contiguous());
            stored.push_back(stored_of(prefix + name, kept.back()));
        }
    metadata["config"] = config;
    write_tensor_file(file, stored, metadata);
}

Weights initial_weights(const Layout& layout, uint64_t seed, const std::function<bool(const std::string&)>& zero) {
    Weights out;
    uint64_t state = seed * 0xd1342543de82ef95ull + 1;
    for (const auto& [name, shape] : layout) {
        Tensor t = at::zeros(shape, at::kFloat);
        const auto ends = [&](const std::string& with) {
            return name.size() >= with.size() && name.compare(name.size() - with.size(), with.size(), with) == 0;
        };
        if (name.find("norm") != std::string::npos || ends("gamma"))
            t.fill_(ends(".bias") ? 0 : 1);
        else if (ends("modulation"))
            fill_uniform(t, std::sqrt(3.0 / double(t.size(-1))), state);
        else if (ends(".weight") && !zero(name))
            fill_uniform(t, std::sqrt(3.0 / double(t.numel() / t.size(0))), state);
        out[name] = t;
    }
    return out;
}

Weights initial_dit(const DitConfig& config, uint64_t seed) {
    return initial_weights(dit_layout(config), seed, [](const std::string& name) { return name == "head.head.weight"; });
}

void widen_input(Weights& weights, DitConfig& config, int64_t in_channels, uint64_t seed, bool zero) {
    if (in_channels < config.in_channels)
        throw Error(ExitCode::bad_input, "model: in_channels: got " + std::to_string(in_channels) +
                                             ", expected at least the " + std::to_string(config.in_channels) + " there");
    const Tensor old = get(weights, "patch_embedding.weight");
    Tensor wide = at::zeros({config.dim, in_channels, config.patch[0], config.patch[1], config.patch[2]}, at::kFloat);
    if (!zero) {  // Kaiming: the variance of a layer of all its inputs, 2 / fan in
        uint64_t state = seed * 0xd1342543de82ef95ull + 2;
        fill_uniform(wide, std::sqrt(6.0 / double(wide.numel() / config.dim)), state);
    }
    wide.narrow(1, 0, config.in_channels).copy_(old);
    weights["patch_embedding.weight"] = wide;
    config.in_channels = in_channels;
}

}  // namespace vshift::inpaint
