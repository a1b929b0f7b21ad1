// SPDX-License-Identifier: Apache-2.0
#include "inpaint/depth_script.h"

#include <torch/csrc/jit/api/module.h>
#include <torch/csrc/jit/serialization/import.h>

#include <fstream>
#include <limits>

#include "embree_core/types.h"

namespace vshift::inpaint {
namespace {

std::string first_line(const std::string& text) {
    return text.substr(0, text.find('\n'));
}

/// Torch names the failing line of the script last.
std::string last_line(std::string text) {
    while (!text.empty() && text.back() == '\n') text.pop_back();
    const size_t at = text.rfind('\n');
    return at == std::string::npos ? text : text.substr(at + 1);
}

std::string shape_of(const at::Tensor& t) {
    std::string text = "[";
    for (int64_t i = 0; i < t.dim(); ++i) text += (i ? ", " : "") + std::to_string(t.size(i));
    return text + "]";
}

}  // namespace

struct DepthScript::Module {
    mutable torch::jit::Module module;
};

bool is_script(const std::string& file) {
    std::ifstream in(file, std::ios::binary);
    char bytes[4] = {};
    return in.read(bytes, 4) && std::string(bytes, 4) == "PK\x03\x04";
}

DepthScript::DepthScript(const std::string& file) : file_(file), module_(std::make_unique<Module>()) {
    try {
        module_->module = torch::jit::load(file, at::kCPU);
        module_->module.eval();
    } catch (const std::exception& e) {
        throw Error(ExitCode::bad_input, file + ": format: got " + first_line(e.what()) + ", expected a TorchScript module");
    }
}

DepthScript::~DepthScript() = default;

at::Tensor DepthScript::depth_of(const at::Tensor& color) const {
    at::NoGradGuard no_grad;
    const int64_t H = color.size(2), W = color.size(3);
    const std::string expected = "forward(colors [1, 3, H, W]) to give z in metres, [1, 1, " + std::to_string(H) + ", " + std::to_string(W) + "]";
    c10::IValue got;
    try {
        got = module_->module.forward({color});
    } catch (const std::exception& e) {
        throw Error(ExitCode::bad_input, file_ + ": forward: got " + last_line(e.what()) + ", expected " + expected);
    }
    if (!got.isTensor()) throw Error(ExitCode::bad_input, file_ + ": forward: got " + got.tagKind() + ", expected " + expected);
    at::Tensor z = got.toTensor().to(at::kCPU, at::kFloat);
    if (z.numel() != H * W || z.dim() < 2 || z.size(-1) != W || z.size(-2) != H)
        throw Error(ExitCode::bad_input, file_ + ": forward: got a tensor of " + shape_of(z) + ", expected " + expected);
    z = z.reshape({H, W});
    return at::where(z > 0, z, at::full_like(z, std::numeric_limits<float>::quiet_NaN())).contiguous();
}

}  // namespace vshift::inpaint
