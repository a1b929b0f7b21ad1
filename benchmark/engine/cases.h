// SPDX-License-Identifier: Apache-2.0
// Role: what `vshift bench` measures on: analytic streets (scenes/analytic), one rig of six cameras at one
// size, and a camera with a shift and its truth.
#pragma once
#include <array>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "scenes/analytic/analytic_street.h"

namespace vshift::bench {

/// A rig at one size in one frame of a street: depth and kind of every camera.
struct World {
    const analytic::StreetScene* street = nullptr;
    std::vector<analytic::RigCamera> rig;
    std::vector<DepthMap> depth;
    std::vector<Grid<uint8_t>> kind;  ///< analytic::Kind per pixel

    /// Only the first `cameras` of the rig get their depth.
    World(const analytic::StreetScene& of, int width, int cameras = 6);
    TrueCamera recorded(int own) const { return analytic::recorded_camera(rig[size_t(own)], frame); }
    TrueCamera shifted(int own, const Shift& shift) const {
        return analytic::shifted_camera(rig[size_t(own)], frame, shift);
    }
    static constexpr int frame = 4;
};

/// One question with its answer: which pixels of camera `own` are hidden from where the shift puts it.
struct Case {
    const World* world = nullptr;
    int own = 0;
    Shift shift;
    Grid<uint8_t> truth;     ///< VSHIFT_TRUTH_* flags
    DepthMap shifted_depth;  ///< what V truly sees: for the peer that is given it

    std::string camera() const { return world->rig[size_t(own)].name; }
    std::string shift_text() const;
};
Case make_case(const World& world, int own, const Shift& shift);
/// The same without truth.
Case make_question(const World& world, int own, const Shift& shift);

/// Moved by x forward and y left, in metres.
Shift moved(double x_m, double y_m);
/// +-1, +-2, +-4 m sideways, 2 m forward, and none; `quick`: fewer.
std::vector<Shift> bench_shifts(bool quick);

/// A depth map as a monocular network gives it: 1/z blurred by a Gaussian of 1 px (edges bleed into each
/// other), then z times exp(0.02 n), n a unit Gaussian field with a correlation length of 16 px (white noise
/// blurred with sigma = 16 px). A fresh `draw` changes n alone. mt19937 seeded with 7919 draw + 1.
DepthMap mono_like(const DepthMap& exact, uint32_t draw);
inline constexpr const char* mono_model =
    "1/z blurred by a Gaussian of sigma 1 px; then z times exp(0.02 n), n Gaussian, unit variance, white noise blurred "
    "with sigma 16 px; a fresh draw changes n alone";

}  // namespace vshift::bench
