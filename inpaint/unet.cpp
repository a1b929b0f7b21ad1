// SPDX-License-Identifier: Apache-2.0
#include "inpaint/unet.h"

#include "inpaint/dit.h"

namespace vshift::inpaint {
namespace {

std::string at_level(const char* part, size_t level) {
    return std::string(part) + "." + std::to_string(level);
}

Tensor conv(const Weights& w, const std::string& name, const Tensor& x, int64_t stride = 1) {
    return at::conv2d(x, get(w, name + ".weight"), get(w, name + ".bias"), stride, 1);
}

/// x + conv2(act(conv1(act(x)) + time)).
Tensor block(const Weights& w, const std::string& name, const Tensor& x, const Tensor& time) {
    const Tensor told = at::linear(time, get(w, name + ".time.weight"), get(w, name + ".time.bias"));
    const Tensor h = conv(w, name + ".conv1", at::silu(x)) + told.unsqueeze(-1).unsqueeze(-1);
    return x + conv(w, name + ".conv2", at::silu(h));
}

Tensor twice_as_large(const Tensor& x) {
    return at::upsample_nearest2d(x, {2 * x.size(2), 2 * x.size(3)});
}

}  // namespace

UnetConfig parse_unet_config(const nlohmann::json& json, const std::string& where) {
    UnetConfig c;
    const auto whole = [&](const nlohmann::json& v, const std::string& key, int64_t least, int64_t most) {
        if (!v.is_number_integer() || v.get<int64_t>() < least || v.get<int64_t>() > most)
            throw Error(ExitCode::bad_input, where + ": " + key + ": got " + v.dump().substr(0, 40) +
                                                 ", expected a whole number from " + std::to_string(least) + " to " +
                                                 std::to_string(most));
        return v.get<int64_t>();
    };
    if (!json.is_object())
        throw Error(ExitCode::bad_input, where + ": got " + json.type_name() + ", expected an object");
    for (const auto& [key, value] : json.items()) {
        if (key == "in_channels") c.in_channels = whole(value, key, 1, 4096);
        else if (key == "out_channels") c.out_channels = whole(value, key, 1, 4096);
        else if (key == "freq_dim") c.freq_dim = 2 * (whole(value, key, 2, 4096) / 2);
        else if (key == "widths" && value.is_array() && value.size() >= 2 && value.size() <= 8) {
            c.widths.clear();
            for (const auto& v : value) c.widths.push_back(whole(v, key, 1, 4096));
        } else
            throw Error(ExitCode::bad_input, where + ": " + key + ": got " + value.dump().substr(0, 40) +
                                                 ", expected in_channels, out_channels, freq_dim or 2 to 8 widths");
    }
    return c;
}

nlohmann::ordered_json json_of(const UnetConfig& c) {
    return {{"in_channels", c.in_channels}, {"out_channels", c.out_channels}, {"widths", c.widths}, {"freq_dim", c.freq_dim}};
}

Layout unet_layout(const UnetConfig& c) {
    Layout l;
    const int64_t time = 4 * c.freq_dim;
    const auto conv3 = [&](const std::string& name, int64_t in, int64_t out) {
        l[name + ".weight"] = {out, in, 3, 3};
        l[name + ".bias"] = {out};
    };
    const auto linear = [&](const std::string& name, int64_t in, int64_t out) {
        l[name + ".weight"] = {out, in};
        l[name + ".bias"] = {out};
    };
    const auto residual = [&](const std::string& name, int64_t width) {
        conv3(name + ".conv1", width, width);
        conv3(name + ".conv2", width, width);
        linear(name + ".time", time, width);
    };
    linear("time.0", c.freq_dim, time);
    linear("time.2", time, time);
    conv3("in", 4 * c.in_channels, c.widths[0]);
    const size_t levels = c.widths.size();
    for (size_t i = 0; i < levels; ++i) {
        residual(at_level("down", i), c.widths[i]);
        if (i + 1 == levels) break;
        conv3(at_level("shrink", i), c.widths[i], c.widths[i + 1]);
        conv3(at_level("grow", i), c.widths[i + 1] + c.widths[i], c.widths[i]);
        residual(at_level("up", i), c.widths[i]);
    }
    residual("middle", c.widths.back());
    conv3("out", c.widths[0], 4 * c.out_channels);
    return l;
}

bool unet_begins_at_zero(const std::string& name) {
    return name == "out.weight" || name.find(".conv2.weight") != std::string::npos;
}

int64_t unet_side(const UnetConfig& c) {
    return int64_t(1) << c.widths.size();
}

Tensor unet_forward(const UnetConfig& c, const Weights& w, const Tensor& input, const Tensor& t) {
    const int64_t B = input.size(0), F = input.size(2), H = input.size(3), W = input.size(4);
    Tensor time = time_sinusoids(t, c.freq_dim);
    time = at::linear(at::silu(at::linear(time, get(w, "time.0.weight"), get(w, "time.0.bias"))), get(w, "time.2.weight"),
                      get(w, "time.2.bias"));
    time = at::silu(time).repeat_interleave(F, 0);
    // Channels last: oneDNN's convolutions are up to twice as fast so.
    const Tensor seen = at::pixel_unshuffle(input.transpose(1, 2).flatten(0, 1), 2);
    Tensor x = conv(w, "in", seen.contiguous(at::MemoryFormat::ChannelsLast));
    std::vector<Tensor> skips;
    const size_t levels = c.widths.size();
    for (size_t i = 0; i < levels; ++i) {
        x = block(w, at_level("down", i), x, time);
        if (i + 1 == levels) break;
        skips.push_back(x);
        x = conv(w, at_level("shrink", i), at::silu(x), 2);
    }
    x = block(w, "middle", x, time);
    for (size_t i = levels - 1; i-- > 0;) {
        x = conv(w, at_level("grow", i), at::silu(at::cat({twice_as_large(x), skips[i]}, 1)));
        x = block(w, at_level("up", i), x, time);
    }
    x = at::pixel_shuffle(conv(w, "out", at::silu(x)), 2).contiguous();
    return x.view({B, F, c.out_channels, H, W}).transpose(1, 2);
}

}  // namespace vshift::inpaint
