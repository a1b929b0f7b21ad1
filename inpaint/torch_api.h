// SPDX-License-Identifier: Apache-2.0
// Role: the one place that includes Torch: ATen and its automatic derivatives, not torch/torch.h, which costs twice
// as much to compile. Precompiled (CMakeLists.txt).
#pragma once
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wunused-parameter"
#pragma GCC diagnostic ignored "-Wdeprecated-declarations"
#include <ATen/ATen.h>
#include <ATen/Parallel.h>
#include <torch/csrc/autograd/autograd.h>
#include <torch/csrc/autograd/grad_mode.h>
#include <torch/version.h>
#pragma GCC diagnostic pop
