// SPDX-License-Identifier: Apache-2.0
// Role: what the parts of the C ABI share: exceptions become codes here, and a training's options are read. Internal.
#pragma once
#include <nlohmann/json.hpp>

#include "inpaint/train.h"

namespace vshift::inpaint {

/// What vshift_inpaint_last_error() gives.
std::string& last_error();

/// Exceptions end here. Torch's are long and tell of frames: the first line will do.
template <class Work>
int guarded(Work work) {
    try {
        work();
        return 0;
    } catch (const Error& e) {
        last_error() = e.what();
        return int(e.code());
    } catch (const c10::Error& e) {
        const std::string text = e.what_without_backtrace();
        const bool memory = text.find("memory") != std::string::npos;
        last_error() = std::string(memory ? "memory" : "torch") + ": got " + text.substr(0, text.find('\n')) +
                       (memory ? ", expected enough for the request" : ", expected no error");
        return int(memory ? ExitCode::over_limit : ExitCode::our_bug);
    } catch (const std::bad_alloc&) {
        last_error() = "memory: got none, expected enough for the request";
        return int(ExitCode::over_limit);
    } catch (const std::exception& e) {
        last_error() = std::string("internal: got ") + e.what() + ", expected no exception (please report this)";
        return int(ExitCode::our_bug);
    }
}

/// Throws Error our_bug: null pointers are the caller's fault.
void require(bool given, const char* what);

/// The options of c_api.h; `model` is JSON.
struct TrainRequest {
    TrainOptions train;
    std::string model = "{}", model_file, curve_file, license, record, autoencoder_file, regression_file, start_file, dit_file;
};
/// Throws Error bad_input: "cuda" without one, and other names.
at::Device device_of(const std::string& name);
TrainRequest parse_train_request(const char* options_json);

/// License and training record for a model's file, with the fields of `more`. No times: the same run gives the same bytes.
std::map<std::string, std::string> training_metadata(const TrainRequest& request, const TrainState& state,
                                                     const nlohmann::ordered_json& more = nullptr);

}  // namespace vshift::inpaint
