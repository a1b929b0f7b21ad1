// SPDX-License-Identifier: Apache-2.0
#include "inpaint/ray_mixer.h"

#include <ATen/Parallel.h>

#include <algorithm>

namespace vshift::inpaint {
namespace {

constexpr int64_t hidden = 32;        // of the layer that looks at one ray
constexpr double fill_first = 3;      // the fill's score at the beginning, where rays have 0
constexpr double added_share = 0.25;  // of the color that is added
constexpr double never = -1e4;
constexpr int64_t beyond_at = 3;  // among a ray's numbers: the color that is mixed
constexpr size_t surface_at = 25;  // the mean color of up to 17 pixels
constexpr size_t pixels_at_once = 768;  // what a cache holds
constexpr int deep_px = 4;

Tensor layer(const Weights& w, const std::string& name, const Tensor& x) {
    return at::linear(x, get(w, name + ".weight"), get(w, name + ".bias"));
}

/// `first`: the rays' first layer; `colors` [N, rays, 3]; `met` [N, rays]: 0 where a ray met nothing. `best`: the ray with
/// the largest weight.
Tensor mixed(const RayMixerConfig& c, const Weights& w, const Tensor& first, const Tensor& colors, const Tensor& met, const Tensor& own,
             Tensor* best = nullptr) {
    const Tensor each = at::relu(layer(w, "ray.1", at::relu(first)));
    Tensor x = at::cat({each.flatten(1), own}, 1);
    for (int64_t i = 0; i < c.layers; ++i) x = at::relu(layer(w, "body." + std::to_string(i), x));
    const Tensor y = layer(w, "out", x);
    const Tensor scores = at::cat({y.narrow(1, 0, 1) + fill_first, y.narrow(1, 1, ray_count).masked_fill(met <= 0, never)}, 1);
    if (best) *best = scores.narrow(1, 1, ray_count).argmax(1);
    const Tensor among = (at::cat({own.narrow(1, 0, 3).unsqueeze(1), colors}, 1) + 1) / 2;
    return (at::softmax(scores, 1).unsqueeze(2) * among).sum(1) + added_share * y.narrow(1, 1 + ray_count, 3);
}

/// `work(first, count)` for every piece of `size` things that a cache holds, on Torch's threads. At least two pieces, so
/// that none is itself spread over threads: the same bytes on any number of them.
template <class Work>
void in_pieces(size_t size, const Work& work) {
    const size_t each = std::max<size_t>(1, std::min(pixels_at_once, (size + 1) / 2));
    const size_t pieces = std::max<size_t>(2, (size + each - 1) / each);
    at::parallel_for(0, int64_t(pieces), 1, [&](int64_t begin, int64_t end) {
        const at::NoGradGuard no_grad;  // each thread's own
        for (size_t from = size_t(begin) * each; from < std::min(size, size_t(end) * each); from += each)
            work(from, int64_t(std::min(each, size - from)));
    });
}

/// Whether a pixel and all within deep_px steps of it are hole.
std::vector<uint8_t> deep_in_holes(const RayPlanes& p) {
    const int W = p.width, H = p.height;
    std::vector<int> steps(size_t(W) * size_t(H));  // to the nearest known pixel, as far as this matters
    const auto nearer = [&](int x, int y, int from_x, int from_y) {
        if (from_x < 0 || from_y < 0 || from_x >= W || from_y >= H) return;
        int& s = steps[size_t(y) * size_t(W) + size_t(x)];
        s = std::min(s, steps[size_t(from_y) * size_t(W) + size_t(from_x)] + 1);
    };
    for (size_t i = 0; i < steps.size(); ++i) steps[i] = p.hole[i] > 0 ? deep_px + 1 : 0;
    for (int y = 0; y < H; ++y)
        for (int x = 0; x < W; ++x) nearer(x, y, x - 1, y), nearer(x, y, x, y - 1);
    for (int y = H - 1; y >= 0; --y)
        for (int x = W - 1; x >= 0; --x) nearer(x, y, x + 1, y), nearer(x, y, x, y + 1);
    std::vector<uint8_t> deep(steps.size());
    for (size_t i = 0; i < steps.size(); ++i) deep[i] = steps[i] > deep_px;
    return deep;
}

}  // namespace

RayMixerConfig parse_ray_mixer_config(const nlohmann::json& json, const std::string& where) {
    RayMixerConfig c;
    if (!json.is_object()) throw Error(ExitCode::bad_input, where + ": got " + json.type_name() + ", expected an object");
    for (const auto& [key, value] : json.items()) {
        if (key == "detail") {
            if (!value.is_number() || !(value.get<double>() >= 0 && value.get<double>() <= 2))
                throw Error(ExitCode::bad_input, where + ": detail: got " + value.dump().substr(0, 40) + ", expected a number from 0 to 2");
            c.detail = value.get<double>();
            continue;
        }
        int64_t* to = key == "ray_dim" ? &c.ray_dim : key == "dim" ? &c.dim : key == "layers" ? &c.layers : nullptr;
        const int64_t most = key == "layers" ? 16 : 1024;
        if (!to || !value.is_number_integer() || value.get<int64_t>() < 1 || value.get<int64_t>() > most)
            throw Error(ExitCode::bad_input, where + ": " + key + ": got " + value.dump().substr(0, 40) +
                                                 ", expected ray_dim or dim (1 to 1024), layers (1 to 16) or detail (0 to 2)");
        *to = value.get<int64_t>();
    }
    return c;
}

nlohmann::ordered_json json_of(const RayMixerConfig& c) {
    return {{"ray_dim", c.ray_dim}, {"dim", c.dim}, {"layers", c.layers}, {"detail", c.detail}};
}

Layout ray_mixer_layout(const RayMixerConfig& c) {
    Layout l;
    const auto linear = [&](const std::string& name, int64_t in, int64_t out) {
        l[name + ".weight"] = {out, in};
        l[name + ".bias"] = {out};
    };
    linear("ray.0", ray_numbers, hidden);
    linear("ray.1", hidden, c.ray_dim);
    for (int64_t i = 0; i < c.layers; ++i)
        linear("body." + std::to_string(i), i == 0 ? ray_count * c.ray_dim + own_numbers : c.dim, c.dim);
    linear("out", c.dim, 1 + ray_count + 3);
    return l;
}

bool ray_mixer_begins_at_zero(const std::string& name) {
    return name == "out.weight";
}

Tensor ray_mixer_forward(const RayMixerConfig& c, const Weights& w, const Tensor& seen) {
    const int64_t n = seen.size(0);
    const Tensor rays = seen.narrow(1, 0, ray_count * ray_numbers).reshape({n, ray_count, ray_numbers});
    return mixed(c, w, layer(w, "ray.0", rays), rays.narrow(2, beyond_at, 3), rays.select(2, ray_numbers - 1),
                 seen.narrow(1, ray_count * ray_numbers, own_numbers));
}

namespace {

/// The colors of the pixels `chosen`, and where asked for their texture.
void mix(const RayMixerConfig& c, const Weights& w, const RayPlanes& p, const std::vector<int32_t>& chosen, float* color, float* texture) {
    const auto n = size_t(p.width) * size_t(p.height);
    const RayNumbers seen = ray_numbers_of(p, chosen);
    const auto tensor = [](const auto& numbers, at::ScalarType type, size_t from, int64_t rows, int64_t each) {
        return at::from_blob(const_cast<void*>(static_cast<const void*>(numbers.data() + from * size_t(each))), {rows, each}, type);
    };
    const at::NoGradGuard no_grad;
    const Tensor edges = tensor(seen.edges, at::kFloat, 0, int64_t(seen.edges.size()) / edge_numbers, edge_numbers);
    const Tensor first = get(w, "ray.0.weight");
    Tensor met = at::empty({edges.size(0), hidden});
    in_pieces(size_t(edges.size(0)), [&](size_t from, int64_t some) {
        met.narrow(0, int64_t(from), some)
            .copy_(at::linear(edges.narrow(0, int64_t(from), some), first.narrow(1, 0, edge_numbers), get(w, "ray.0.bias")));
    });
    const Tensor way_weight = first.narrow(1, edge_numbers, way_numbers).t();
    const Tensor beyond = edges.narrow(1, beyond_at, 3).contiguous();
    in_pieces(chosen.size(), [&](size_t from, int64_t some) {
        const Tensor edge = tensor(seen.edge, at::kInt, from, some, ray_count).flatten();
        const Tensor ways = tensor(seen.ways, at::kFloat, from * ray_count, some * ray_count, way_numbers);
        Tensor best;
        const Tensor colors = mixed(c, w, at::addmm(met.index_select(0, edge), ways, way_weight).view({some, ray_count, hidden}),
                                    beyond.index_select(0, edge).view({some, ray_count, 3}),
                                    ways.select(1, way_numbers - 1).view({some, ray_count}),
                                    tensor(seen.own, at::kFloat, from, some, own_numbers), &best);
        const auto made = colors.accessor<float, 2>();
        const auto ray = best.accessor<int64_t, 1>();
        for (int64_t i = 0; i < some; ++i) {
            const size_t number = from + size_t(i), to = size_t(chosen[number]);
            for (size_t k = 0; k < 3; ++k) color[k * n + to] = made[i][int64_t(k)];
            if (!texture) continue;
            const auto edge_of = size_t(seen.edge[number * ray_count + size_t(ray[i])]);
            const float* met_there = seen.edges.data() + edge_of * edge_numbers;
            const auto there = edge_of > 0 ? size_t(mirrored_at_edge(p, chosen[number], size_t(ray[i]), met_there)) : 0;
            for (size_t k = 0; k < 3; ++k)
                texture[k * n + to] = edge_of > 0 ? p.fill[k * n + there] - (met_there[surface_at + k] + 1) / 2 : 0;
        }
    });
}

std::vector<int32_t> holes_of(const RayPlanes& p) {
    std::vector<int32_t> holes;
    for (size_t i = 0; i < size_t(p.width) * size_t(p.height); ++i)
        if (p.hole[i] > 0) holes.push_back(int32_t(i));
    return holes;
}

}  // namespace

void ray_mixer_texture(const RayMixerConfig& c, const Weights& w, const RayPlanes& p, float* color, float* texture) {
    mix(c, w, p, holes_of(p), color, texture);
}

void ray_mixer_fill(const RayMixerConfig& c, const Weights& w, const RayPlanes& p, float* color) {
    const auto W = size_t(p.width), n = W * size_t(p.height);
    std::vector<int32_t> chosen, between;
    std::vector<float> texture;
    if (c.detail > 0) {
        chosen = holes_of(p);
        texture.resize(3 * n);
    } else {
        const std::vector<uint8_t> deep = deep_in_holes(p);
        for (const int32_t i : holes_of(p)) (deep[size_t(i)] && (size_t(i) % W + size_t(i) / W) % 2 ? between : chosen).push_back(i);
    }
    mix(c, w, p, chosen, color, c.detail > 0 ? texture.data() : nullptr);
    for (const int32_t i : chosen)
        for (size_t at = size_t(i); at < 3 * n; at += n)
            color[at] = std::clamp(color[at] + (c.detail > 0 ? float(c.detail) * texture[at] : 0), 0.0f, 1.0f);
    for (const int32_t i : between) {
        const size_t at = size_t(i), x = at % W;
        for (size_t k = 0; k < 3; ++k) {
            const float* plane = color + k * n;
            float sum = 0, count = 0;
            const auto add = [&](bool inside, size_t there) {
                if (inside) sum += plane[there], count += 1;
            };
            add(x > 0, at - 1);
            add(x + 1 < W, at + 1);
            add(at >= W, at - W);
            add(at + W < n, at + W);
            color[k * n + at] = sum / count;
        }
    }
}

}  // namespace vshift::inpaint
