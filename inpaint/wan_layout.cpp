// SPDX-License-Identifier: Apache-2.0
#include "inpaint/wan_layout.h"

#include <algorithm>
#include <cmath>
#include <set>

namespace vshift::inpaint {
namespace {

using nlohmann::json;
using nlohmann::ordered_json;

[[noreturn]] void refuse(const std::string& where, const std::string& got, const std::string& expected) {
    throw Error(ExitCode::bad_input, where + ": got " + got + ", expected " + expected);
}

/// Fields of a config object, each checked as it is taken; what is left over is unknown.
class ConfigFields {
public:
    ConfigFields(const json& object, std::string where) : object_(object), where_(std::move(where)) {
        if (!object.is_object()) refuse(where_, object.type_name(), "an object");
        for (const auto& [key, value] : object.items()) left_.insert(key);
    }
    const json* take(const std::string& key) {
        left_.erase(key);
        const auto at = object_.find(key);
        return at == object_.end() ? nullptr : &*at;
    }
    int64_t whole(const json& value, const std::string& key, int64_t least, int64_t most) const {
        if (!value.is_number_integer() || value.get<int64_t>() < least || value.get<int64_t>() > most)
            refuse(where_ + ": " + key, value.dump().substr(0, 40),
                   "a whole number from " + std::to_string(least) + " to " + std::to_string(most));
        return value.get<int64_t>();
    }
    void whole(const std::string& key, int64_t& to, int64_t least, int64_t most) {
        if (const json* v = take(key)) to = whole(*v, key, least, most);
    }
    const json* list(const std::string& key, size_t least, size_t most) {
        const json* v = take(key);
        if (v && (!v->is_array() || v->size() < least || v->size() > most))
            refuse(where_ + ": " + key, v->dump().substr(0, 40),
                   "a list of " + std::to_string(least) + " to " + std::to_string(most));
        return v;
    }
    void finish() const {
        if (!left_.empty()) refuse(where_ + ": " + *left_.begin(), "an unknown field", "none");
    }
    const std::string& where() const { return where_; }

private:
    const json& object_;
    std::string where_;
    std::set<std::string> left_;
};

using Rule = std::pair<std::string, std::string>;

/// The first rule whose left side is found replaces it there; parts of a name are matched whole, between dots.
std::string renamed(const std::string& name, const std::vector<Rule>& rules) {
    std::string text = "." + name + ".";
    for (const auto& [from, to] : rules)
        if (const size_t at = text.find("." + from + "."); at != std::string::npos)
            text.replace(at + 1, from.size(), to);
    return text.substr(1, text.size() - 2);
}

std::vector<Rule> turned(std::vector<Rule> rules) {
    for (auto& [from, to] : rules) std::swap(from, to);
    return rules;
}

const std::vector<Rule>& dit_rules() {  // Wan2.2's name, Diffusers' name
    static const std::vector<Rule> rules{
        {"time_embedding.0", "condition_embedder.time_embedder.linear_1"},
        {"time_embedding.2", "condition_embedder.time_embedder.linear_2"},
        {"text_embedding.0", "condition_embedder.text_embedder.linear_1"},
        {"text_embedding.2", "condition_embedder.text_embedder.linear_2"},
        {"time_projection.1", "condition_embedder.time_proj"},
        {"head.head", "proj_out"},
        {"self_attn.q", "attn1.to_q"},
        {"self_attn.k", "attn1.to_k"},
        {"self_attn.v", "attn1.to_v"},
        {"self_attn.o", "attn1.to_out.0"},
        {"self_attn.norm_q", "attn1.norm_q"},
        {"self_attn.norm_k", "attn1.norm_k"},
        {"cross_attn.q", "attn2.to_q"},
        {"cross_attn.k", "attn2.to_k"},
        {"cross_attn.v", "attn2.to_v"},
        {"cross_attn.o", "attn2.to_out.0"},
        {"cross_attn.norm_q", "attn2.norm_q"},
        {"cross_attn.norm_k", "attn2.norm_k"},
        {"ffn.0", "ffn.net.0.proj"},
        {"ffn.2", "ffn.net.2"},
        {"norm3", "norm2"},  // the affine one, before the cross-attention
    };
    return rules;
}

std::vector<Rule> vae_rules(const std::string& name, bool to_diffusers) {
    // A residual block's parts, and where blocks stand, depend on the level: rules are made for the name's own parts.
    std::vector<Rule> rules{{"residual.0", "norm1"}, {"residual.2", "conv1"}, {"residual.3", "norm2"},
                            {"residual.6", "conv2"}, {"shortcut", "conv_shortcut"}};
    const bool encoder = name.rfind("encoder.", 0) == 0, decoder = name.rfind("decoder.", 0) == 0;
    if (!encoder && !decoder) return {{"conv1", "quant_conv"}, {"conv2", "post_quant_conv"}};
    const std::string side = encoder ? "encoder" : "decoder";
    const bool top = (to_diffusers ? name.rfind(side + ".conv1", 0) == 0 || name.rfind(side + ".head", 0) == 0
                                   : name.rfind(side + ".conv_", 0) == 0 || name.rfind(side + ".norm_out", 0) == 0);
    if (top)
        return {{side + ".conv1", side + ".conv_in"}, {side + ".head.0", side + ".norm_out"},
                {side + ".head.2", side + ".conv_out"}};
    rules.push_back({side + ".middle.0", side + ".mid_block.resnets.0"});
    rules.push_back({side + ".middle.1", side + ".mid_block.attentions.0"});
    rules.push_back({side + ".middle.2", side + ".mid_block.resnets.1"});
    return rules;
}

/// "encoder.downsamples.1.downsamples.2.X": {"encoder", 1, 2, "X"}; empty side when it is no such name.
struct LevelName {
    std::string side;
    std::string level, block, rest;
};
LevelName level_name(const std::string& name, const std::string& outer_encoder, const std::string& outer_decoder) {
    for (const auto& [side, outer] : {Rule{"encoder", outer_encoder}, Rule{"decoder", outer_decoder}}) {
        const std::string head = side + "." + outer + ".";
        if (name.rfind(head, 0) != 0) continue;
        const size_t dot = name.find('.', head.size());
        if (dot == std::string::npos) continue;
        return {side, name.substr(head.size(), dot - head.size()), "", name.substr(dot + 1)};
    }
    return {};
}

}  // namespace

DitConfig parse_dit_config(const json& object, const std::string& where) {
    ConfigFields f(object, where);
    DitConfig c;
    f.whole("in_channels", c.in_channels, 1, 4096);
    f.whole("out_channels", c.out_channels, 1, 4096);
    f.whole("dim", c.dim, 8, 16384);
    f.whole("ffn_dim", c.ffn_dim, 1, 65536);
    f.whole("layers", c.layers, 1, 256);
    f.whole("heads", c.heads, 1, 256);
    f.whole("freq_dim", c.freq_dim, 2, 4096);
    f.whole("text_dim", c.text_dim, 0, 16384);
    f.whole("text_len", c.text_len, 1, 4096);
    f.whole("reach", c.reach, 0, 4096);
    if (const json* p = f.list("patch", 3, 3))
        for (size_t i = 0; i < 3; ++i) c.patch[i] = f.whole((*p)[i], "patch", 1, 64);
    if (const json* e = f.take("eps")) {
        if (!e->is_number() || !(e->get<double>() > 0 && e->get<double>() < 1))
            refuse(where + ": eps", e->dump().substr(0, 40), "a number between 0 and 1");
        c.eps = e->get<double>();
    }
    f.finish();
    if (c.patch[0] != 1) refuse(where + ": patch", std::to_string(c.patch[0]) + " frames", "1");
    if (c.dim % (2 * c.heads) != 0 || c.dim / c.heads < 6)
        refuse(where + ": heads", std::to_string(c.heads) + " for dim " + std::to_string(c.dim),
               "heads of an even width of at least 6");
    if (c.freq_dim % 2) refuse(where + ": freq_dim", std::to_string(c.freq_dim), "an even number");
    return c;
}

VaeConfig parse_vae_config(const json& object, const std::string& where) {
    ConfigFields f(object, where);
    VaeConfig c;
    f.whole("dim", c.dim, 1, 4096);
    f.whole("dec_dim", c.dec_dim, 1, 4096);
    f.whole("z_dim", c.z_dim, 1, 1024);
    f.whole("res_blocks", c.res_blocks, 1, 16);
    if (const json* m = f.list("dim_mult", 1, 8)) {
        c.dim_mult.clear();
        for (const json& v : *m) c.dim_mult.push_back(f.whole(v, "dim_mult", 1, 64));
    }
    if (const json* m = f.list("temporal_down", 0, 8)) {
        c.temporal_down.clear();
        for (const json& v : *m) {
            if (!v.is_boolean()) refuse(where + ": temporal_down", v.dump().substr(0, 40), "true or false");
            c.temporal_down.push_back(v.get<bool>());
        }
    }
    if (c.temporal_down.size() + 1 != c.dim_mult.size())
        refuse(where + ": temporal_down", std::to_string(c.temporal_down.size()) + " entries",
               "one fewer than dim_mult has");
    for (auto [key, to] : {std::pair<const char*, std::vector<float>*>{"mean", &c.mean}, {"std", &c.std}})
        if (const json* m = f.list(key, size_t(c.z_dim), size_t(c.z_dim)))
            for (const json& v : *m) {
                const double number = v.is_number() ? v.get<double>() : NAN;
                if (!(std::abs(number) < 1e6) || (key[0] == 's' && number <= 0))
                    refuse(where + ": " + key, v.dump().substr(0, 40), "finite numbers, above 0 for std");
                to->push_back(float(number));
            }
    f.finish();
    // Shortcuts of blocks that change size average or repeat whole groups of channels.
    const auto fits = [&](int64_t many, int64_t few) { return many % few == 0; };
    int64_t in = c.dim;
    for (size_t i = 0; i < c.dim_mult.size(); ++i) {
        const bool last = i + 1 == c.dim_mult.size();
        const int64_t out = c.dim * c.dim_mult[i], factor = last ? 1 : (c.temporal_down[i] ? 8 : 4);
        if (!fits(in * factor, out))
            refuse(where + ": dim_mult", std::to_string(out) + " channels at level " + std::to_string(i),
                   "a divisor of " + std::to_string(in * factor));
        in = out;
    }
    for (size_t i = 0; i + 1 < c.dim_mult.size(); ++i) {
        const int64_t from = c.dec_dim * (i == 0 ? c.dim_mult.back() : c.dim_mult[c.dim_mult.size() - i]);
        const int64_t out = c.dec_dim * c.dim_mult[c.dim_mult.size() - 1 - i];
        const int64_t factor = c.temporal_down[c.temporal_down.size() - 1 - i] ? 8 : 4;
        if (!fits(out * factor, from))
            refuse(where + ": dim_mult", std::to_string(from) + " channels into the decoder's level " + std::to_string(i),
                   "a divisor of " + std::to_string(out * factor));
    }
    return c;
}

ordered_json json_of(const DitConfig& c) {
    return {{"in_channels", c.in_channels}, {"out_channels", c.out_channels}, {"dim", c.dim},
            {"ffn_dim", c.ffn_dim},         {"layers", c.layers},             {"heads", c.heads},
            {"freq_dim", c.freq_dim},       {"text_dim", c.text_dim},         {"text_len", c.text_len},
            {"patch", c.patch},             {"reach", c.reach},               {"eps", c.eps}};
}

ordered_json json_of(const VaeConfig& c) {
    ordered_json j = {{"dim", c.dim},           {"dec_dim", c.dec_dim},       {"z_dim", c.z_dim},
                      {"dim_mult", c.dim_mult}, {"res_blocks", c.res_blocks}, {"temporal_down", c.temporal_down}};
    if (!c.mean.empty()) j["mean"] = c.mean;
    if (!c.std.empty()) j["std"] = c.std;
    return j;
}

Layout dit_layout(const DitConfig& c) {
    Layout l;
    const auto linear = [&](const std::string& name, int64_t in, int64_t out) {
        l[name + ".weight"] = {out, in};
        l[name + ".bias"] = {out};
    };
    l["patch_embedding.weight"] = {c.dim, c.in_channels, c.patch[0], c.patch[1], c.patch[2]};
    l["patch_embedding.bias"] = {c.dim};
    linear("time_embedding.0", c.freq_dim, c.dim);
    linear("time_embedding.2", c.dim, c.dim);
    linear("time_projection.1", c.dim, 6 * c.dim);
    if (c.text_dim) {
        linear("text_embedding.0", c.text_dim, c.dim);
        linear("text_embedding.2", c.dim, c.dim);
    }
    for (int64_t i = 0; i < c.layers; ++i) {
        const std::string block = "blocks." + std::to_string(i) + ".";
        l[block + "modulation"] = {1, 6, c.dim};
        for (const std::string attention : {"self_attn", "cross_attn"}) {
            if (attention == "cross_attn" && !c.text_dim) continue;
            for (const char* part : {".q", ".k", ".v", ".o"}) linear(block + attention + part, c.dim, c.dim);
            for (const char* part : {".norm_q.weight", ".norm_k.weight"}) l[block + attention + part] = {c.dim};
        }
        if (c.text_dim)
            for (const char* part : {"norm3.weight", "norm3.bias"}) l[block + part] = {c.dim};
        linear(block + "ffn.0", c.dim, c.ffn_dim);
        linear(block + "ffn.2", c.ffn_dim, c.dim);
    }
    l["head.modulation"] = {1, 2, c.dim};
    linear("head.head", c.dim, c.out_channels * c.patch[0] * c.patch[1] * c.patch[2]);
    return l;
}

Layout vae_layout(const VaeConfig& c) {
    Layout l;
    const auto conv = [&](const std::string& name, int64_t in, int64_t out, int64_t t, int64_t side) {
        l[name + ".weight"] = t ? Shape{out, in, t, side, side} : Shape{out, in, side, side};
        l[name + ".bias"] = {out};
    };
    const auto residual = [&](const std::string& name, int64_t in, int64_t out) {
        l[name + ".residual.0.gamma"] = {in, 1, 1, 1};
        conv(name + ".residual.2", in, out, 3, 3);
        l[name + ".residual.3.gamma"] = {out, 1, 1, 1};
        conv(name + ".residual.6", out, out, 3, 3);
        if (in != out) conv(name + ".shortcut", in, out, 1, 1);
    };
    const auto middle = [&](const std::string& side, int64_t dim) {
        residual(side + ".middle.0", dim, dim);
        l[side + ".middle.1.norm.gamma"] = {dim, 1, 1};
        conv(side + ".middle.1.to_qkv", dim, 3 * dim, 0, 1);
        conv(side + ".middle.1.proj", dim, dim, 0, 1);
        residual(side + ".middle.2", dim, dim);
    };
    const size_t levels = c.dim_mult.size();
    const int64_t pixels = 12;  // 3 colors of 2x2 pixels
    int64_t in = c.dim;
    conv("encoder.conv1", pixels, in, 3, 3);
    for (size_t i = 0; i < levels; ++i) {
        const std::string level = "encoder.downsamples." + std::to_string(i) + ".downsamples.";
        const int64_t out = c.dim * c.dim_mult[i];
        for (int64_t k = 0; k < c.res_blocks; ++k) residual(level + std::to_string(k), k ? out : in, out);
        in = out;
        if (i + 1 == levels) break;
        const std::string down = level + std::to_string(c.res_blocks);
        conv(down + ".resample.1", out, out, 0, 3);
        if (c.temporal_down[i]) {
            l[down + ".time_conv.weight"] = {out, out, 3, 1, 1};
            l[down + ".time_conv.bias"] = {out};
        }
    }
    middle("encoder", in);
    l["encoder.head.0.gamma"] = {in, 1, 1, 1};
    conv("encoder.head.2", in, 2 * c.z_dim, 3, 3);
    conv("conv1", 2 * c.z_dim, 2 * c.z_dim, 1, 1);
    conv("conv2", c.z_dim, c.z_dim, 1, 1);

    in = c.dec_dim * c.dim_mult.back();
    conv("decoder.conv1", c.z_dim, in, 3, 3);
    middle("decoder", in);
    for (size_t i = 0; i < levels; ++i) {
        const std::string level = "decoder.upsamples." + std::to_string(i) + ".upsamples.";
        const int64_t out = c.dec_dim * c.dim_mult[levels - 1 - i];
        for (int64_t k = 0; k <= c.res_blocks; ++k) residual(level + std::to_string(k), k ? out : in, out);
        in = out;
        if (i + 1 == levels) break;
        const std::string up = level + std::to_string(c.res_blocks + 1);
        conv(up + ".resample.1", out, out, 0, 3);
        if (c.temporal_down[levels - 2 - i]) {
            l[up + ".time_conv.weight"] = {2 * out, out, 3, 1, 1};
            l[up + ".time_conv.bias"] = {2 * out};
        }
    }
    l["decoder.head.0.gamma"] = {in, 1, 1, 1};
    conv("decoder.head.2", in, pixels, 3, 3);
    return l;
}

std::string dit_name_from_diffusers(const std::string& name) {
    if (name == "scale_shift_table") return "head.modulation";
    static const std::vector<Rule> rules = turned(dit_rules());
    std::string out = renamed(name, rules);
    if (const size_t at = out.find(".scale_shift_table"); at != std::string::npos) out.replace(at, 18, ".modulation");
    return out;
}
std::string dit_name_to_diffusers(const std::string& name) {
    if (name == "head.modulation") return "scale_shift_table";
    std::string out = renamed(name, dit_rules());
    if (const size_t at = out.find(".modulation"); at != std::string::npos) out.replace(at, 11, ".scale_shift_table");
    return out;
}

std::string vae_name_to_diffusers(const std::string& name) {
    const LevelName level = level_name(name, "downsamples", "upsamples");
    if (level.side.empty()) return renamed(name, vae_rules(name, true));
    const bool encoder = level.side == "encoder";
    const std::string inner = encoder ? "downsamples." : "upsamples.", head = level.side +
        (encoder ? ".down_blocks." : ".up_blocks.") + level.level + ".";
    std::string rest = level.rest.rfind(inner, 0) == 0 ? level.rest.substr(inner.size()) : level.rest;
    const size_t dot = rest.find('.');
    const std::string block = rest.substr(0, dot), part = dot == std::string::npos ? "" : rest.substr(dot + 1);
    if (part.rfind("resample.", 0) == 0 || part.rfind("time_conv.", 0) == 0)
        return head + (encoder ? "downsampler." : "upsampler.") + part;
    return head + "resnets." + block + "." + renamed(part, vae_rules("encoder.", true));
}

std::string vae_name_from_diffusers(const std::string& name) {
    const LevelName level = level_name(name, "down_blocks", "up_blocks");
    if (level.side.empty()) return renamed(name, turned(vae_rules(name, false)));
    const bool encoder = level.side == "encoder";
    const std::string inner = encoder ? "downsamples." : "upsamples.";
    const std::string head = level.side + "." + inner + level.level + "." + inner;
    const std::string sampler = encoder ? "downsampler." : "upsampler.";
    // A level's resampling comes after its blocks: its number is known from the layout alone ("*", see below).
    if (level.rest.rfind(sampler, 0) == 0) return head + "*." + level.rest.substr(sampler.size());
    if (level.rest.rfind("resnets.", 0) != 0) return name;
    const std::string rest = level.rest.substr(8);
    const size_t dot = rest.find('.');
    if (dot == std::string::npos) return name;
    return head + rest.substr(0, dot + 1) + renamed(rest.substr(dot + 1), turned(vae_rules("encoder.", false)));
}

std::map<std::string, StoredTensor> require_layout(const TensorFiles& files, const Layout& expected, Network network) {
    const auto of_diffusers = network == Network::dit ? dit_name_from_diffusers : vae_name_from_diffusers;
    const std::string mark = network == Network::dit ? "condition_embedder.time_proj.weight" : "quant_conv.weight";
    const bool diffusers = files.find(mark) != nullptr;
    // "encoder.downsamples.0.downsamples.*.resample.1.weight" to the number that the layout gives.
    std::map<std::string, std::string> starred;
    if (diffusers && network == Network::vae)
        for (const auto& [name, shape] : expected)
            for (const char* part : {".resample.", ".time_conv."})
                if (const size_t at = name.find(part); at != std::string::npos)
                    starred[name.substr(0, name.rfind('.', at - 1) + 1) + "*" + name.substr(at)] = name;

    std::map<std::string, StoredTensor> found;
    std::vector<std::string> missing, extra, misshapen;
    for (const StoredTensor& t : files.tensors()) {
        std::string name = diffusers ? of_diffusers(t.name) : t.name;
        if (const auto at = starred.find(name); at != starred.end()) name = at->second;
        const auto at = expected.find(name);
        if (at == expected.end() || !found.emplace(name, t).second)
            extra.push_back(t.name);
        else if (at->second != t.shape)
            misshapen.push_back(t.name + " has shape " + text_of(t.shape) + ", expected " + text_of(at->second));
        else if (t.type != ElementType::f32 && t.type != ElementType::bf16 && t.type != ElementType::f16 &&
                 t.type != ElementType::f64)
            misshapen.push_back(t.name + " is " + name_of(t.type) + ", expected a float type");
    }
    for (const auto& [name, shape] : expected)
        if (!found.count(name))
            missing.push_back(!diffusers                   ? name
                              : network == Network::dit ? dit_name_to_diffusers(name)
                                                        : vae_name_to_diffusers(name));
    if (missing.empty() && extra.empty() && misshapen.empty()) return found;
    std::string text = files.file() + ": tensors: got ";
    const auto told = [&](const std::vector<std::string>& names, const std::string& what) {
        if (!names.empty()) text += std::to_string(names.size()) + " " + what + " (first " + names[0].substr(0, 160) + "), ";
    };
    told(missing, "missing");
    told(extra, "extra");
    told(misshapen, "misshapen");
    throw Error(ExitCode::bad_input, text + "expected the " + std::to_string(expected.size()) + " of the " +
                                         (network == Network::dit ? "DiT" : "VAE") + "'s config");
}

}  // namespace vshift::inpaint
