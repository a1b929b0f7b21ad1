// SPDX-License-Identifier: Apache-2.0
#include "inpaint/ray_mixer.h"

#include <ATen/Parallel.h>

#include <algorithm>
#include <array>

namespace vshift::inpaint {
namespace {

constexpr int64_t hidden = 32;        // of the layer that looks at one ray
constexpr double fill_first = 3;      // the fill's score at the beginning, where rays have 0
constexpr double added_share = 0.25;  // of the color that is added
constexpr double never = -1e4;
constexpr int64_t beyond_at = 3;  // among a ray's numbers: the color that is mixed
constexpr size_t surface_at = 25;  // the mean color of up to 17 pixels
constexpr size_t pixels_at_once = 768;  // what a cache holds
constexpr std::array<int, 3> deep_px{3, 6, 12};  // steps into a hole beyond which the next grid will do

Tensor layer(const Weights& w, const std::string& name, const Tensor& x) {
    return at::linear(x, get(w, name + ".weight"), get(w, name + ".bias"));
}

/// `first` [N, rays, hidden]: the rays' first layer, overwritten. Returns [N, 1 + rays + 3]: scores of the fill and of each ray, and the
/// color that is added.
Tensor scored(const RayMixerConfig& c, const Weights& w, const Tensor& first, const Tensor& own) {
    const Tensor each = layer(w, "ray.1", first.relu_()).relu_();
    Tensor x = at::cat({each.flatten(1), own}, 1);
    for (int64_t i = 0; i < c.layers; ++i) x = layer(w, "body." + std::to_string(i), x).relu_();
    return layer(w, "out", x);
}

/// The share of the fill and of each ray; `met` [N, rays]: 0 where a ray met nothing.
Tensor shares_of(const Tensor& y, const Tensor& met) {
    return at::softmax(at::cat({y.narrow(1, 0, 1) + fill_first, y.narrow(1, 1, ray_count).masked_fill(met <= 0, never)}, 1), 1);
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

/// Steps along rows and columns to the nearest known pixel; `most` from there on.
std::vector<int> steps_into_holes(const RayPlanes& p, int most) {
    const int W = p.width, H = p.height;
    std::vector<int> steps(size_t(W) * size_t(H));
    const auto nearer = [&](int x, int y, int from_x, int from_y) {
        if (from_x < 0 || from_y < 0 || from_x >= W || from_y >= H) return;
        int& s = steps[size_t(y) * size_t(W) + size_t(x)];
        s = std::min(s, steps[size_t(from_y) * size_t(W) + size_t(from_x)] + 1);
    };
    for (size_t i = 0; i < steps.size(); ++i) steps[i] = p.hole[i] > 0 ? most : 0;
    for (int y = 0; y < H; ++y)
        for (int x = 0; x < W; ++x) nearer(x, y, x - 1, y), nearer(x, y, x, y - 1);
    for (int y = H - 1; y >= 0; --y)
        for (int x = W - 1; x >= 0; --x) nearer(x, y, x + 1, y), nearer(x, y, x, y + 1);
    return steps;
}

/// Grids of pixels, each half of the one before: all, every other one, every other one of even rows, and so on.
bool on_grid(size_t grid, size_t x, size_t y) {
    const size_t side = size_t(1) << (grid / 2);
    return grid % 2 ? x % side == 0 && y % side == 0 && (x / side + y / side) % 2 == 0 : x % side == 0 && y % side == 0;
}

/// Pixels of a finer grid that are not on `grid`: the mean of their neighbours there.
void fill_between(const std::vector<int32_t>& pixels, size_t grid, const RayPlanes& p, float* color) {
    const auto W = int64_t(p.width), H = int64_t(p.height), side = int64_t(1) << ((grid - 1) / 2);
    constexpr int64_t beside[2][4][2] = {{{1, 1}, {-1, 1}, {1, -1}, {-1, -1}}, {{1, 0}, {-1, 0}, {0, 1}, {0, -1}}};
    for (const int32_t at : pixels)
        for (int64_t k = 0; k < 3; ++k) {
            float* plane = color + k * W * H;
            float sum = 0, count = 0;
            for (const auto& [dx, dy] : beside[grid % 2]) {
                const int64_t x = at % W + dx * side, y = at / W + dy * side;
                if (x >= 0 && y >= 0 && x < W && y < H) sum += plane[y * W + x], count += 1;
            }
            if (count > 0) plane[at] = sum / count;
        }
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
    const Tensor own = seen.narrow(1, ray_count * ray_numbers, own_numbers);
    const Tensor y = scored(c, w, layer(w, "ray.0", rays), own);
    const Tensor among = (at::cat({own.narrow(1, 0, 3).unsqueeze(1), rays.narrow(2, beyond_at, 3)}, 1) + 1) / 2;
    return (shares_of(y, rays.select(2, ray_numbers - 1)).unsqueeze(2) * among).sum(1) + added_share * y.narrow(1, 1 + ray_count, 3);
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
    in_pieces(chosen.size(), [&](size_t from, int64_t some) {
        const Tensor edge = tensor(seen.edge, at::kInt, from, some, ray_count).flatten();
        const Tensor ways = tensor(seen.ways, at::kFloat, from * ray_count, some * ray_count, way_numbers);
        const Tensor y = scored(c, w, met.index_select(0, edge).addmm_(ways, way_weight).view({some, ray_count, hidden}),
                                tensor(seen.own, at::kFloat, from, some, own_numbers));
        const Tensor shares = shares_of(y, ways.select(1, way_numbers - 1).view({some, ray_count}));
        const auto added = y.accessor<float, 2>(), share = shares.accessor<float, 2>();
        for (int64_t i = 0; i < some; ++i) {
            const size_t number = from + size_t(i), to = size_t(chosen[number]);
            const float* of = share[i].data();
            const auto numbers_of = [&](size_t ray) { return seen.edges.data() + size_t(seen.edge[number * ray_count + ray]) * edge_numbers; };
            std::array<float, 3> mean{};
            for (size_t k = 0; k < 3; ++k) mean[k] = of[0] * seen.own[number * own_numbers + k];
            for (size_t ray = 0; ray < ray_count; ++ray)
                for (size_t k = 0; k < 3; ++k) mean[k] += of[1 + ray] * numbers_of(ray)[beyond_at + int64_t(k)];
            for (size_t k = 0; k < 3; ++k) color[k * n + to] = (mean[k] + 1) / 2 + float(added_share) * added[i][int64_t(1 + ray_count + k)];
            if (!texture) continue;
            const auto best = size_t(std::max_element(of + 1, of + 1 + ray_count) - of - 1);
            const float* met_there = numbers_of(best);
            const bool met_one = met_there != seen.edges.data();  // the first edge is none
            const auto there = met_one ? size_t(mirrored_at_edge(p, chosen[number], best, met_there)) : 0;
            for (size_t k = 0; k < 3; ++k) texture[k * n + to] = met_one ? p.fill[k * n + there] - (met_there[surface_at + k] + 1) / 2 : 0;
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
    std::vector<int32_t> chosen;
    std::array<std::vector<int32_t>, deep_px.size()> between;  // by the first grid that they are not on
    std::vector<float> texture;
    if (c.detail > 0) {
        chosen = holes_of(p);
        texture.resize(3 * n);
    } else {
        const std::vector<int> steps = steps_into_holes(p, deep_px.back() + 1);
        for (const int32_t i : holes_of(p)) {
            const auto at = size_t(i);
            size_t grid = 0;
            const auto deeper = [&] { return grid < deep_px.size() && steps[at] > deep_px[grid]; };
            while (deeper() && on_grid(grid + 1, at % W, at / W)) ++grid;
            (deeper() ? between[grid] : chosen).push_back(i);
        }
    }
    mix(c, w, p, chosen, color, c.detail > 0 ? texture.data() : nullptr);
    for (const int32_t i : chosen)
        for (size_t at = size_t(i); at < 3 * n; at += n)
            color[at] = std::clamp(color[at] + (c.detail > 0 ? float(c.detail) * texture[at] : 0), 0.0f, 1.0f);
    for (size_t grid = between.size(); grid > 0; --grid) fill_between(between[grid - 1], grid, p, color);
}

}  // namespace vshift::inpaint
