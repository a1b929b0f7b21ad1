// SPDX-License-Identifier: Apache-2.0
// Role: answers that OIIO asks for many times over, computed once. OIIO opens a name 3 to 13 times per
// command and from several threads; this keeps what was computed while it fits a bound.
#pragma once
#include <cstddef>
#include <list>
#include <memory>
#include <mutex>
#include <string>
#include <unordered_map>
#include <vector>

#include "embree_core/answer.h"

namespace vshift::oiio {

using SharedAnswer = std::shared_ptr<const Answer>;

/// Safe across threads. Computations run one after the other (each uses all cores), and a name that
/// several threads ask for at once is computed by the first of them.
class AnswerCache {
public:
    static constexpr size_t default_limit_bytes = size_t(1) << 30;

    /// The answers of the cameras that `query` (`k=v&k=v`, may be empty) and then `defaults` ask of the recipe, in
    /// the recipe's order. Computed where no answer to the same request, from files of the same size
    /// and times, is kept. Throws Error, exactly as the command line does.
    std::vector<SharedAnswer> answers(const std::string& recipe_file, const std::string& query,
                                      const std::vector<std::pair<std::string, std::string>>& defaults);

    /// Answers used longest ago are dropped until the rest fits; one that is alone too large is not kept.
    void set_limit(size_t bytes);

private:
    struct Entry {
        std::string key;
        SharedAnswer answer;
        size_t bytes = 0;
    };

    std::shared_ptr<const Recipe> recipe(const std::string& file);
    SharedAnswer one(const Recipe& recipe, const std::string& recipe_stamp, const Request& request, FrameFiles& files);
    SharedAnswer find(const std::string& key);
    void keep(const std::string& key, const SharedAnswer& answer);
    void drop_to(size_t limit_bytes);

    std::mutex computing_;      // held while an answer is computed; taken before state_
    std::mutex state_;          // held for look-ups only
    std::list<Entry> entries_;  // used last in front
    std::unordered_map<std::string, std::list<Entry>::iterator> places_;
    size_t kept_bytes_ = 0;
    size_t limit_bytes_ = default_limit_bytes;
    std::string recipe_stamp_;  // of recipe_, the one used last
    std::shared_ptr<const Recipe> recipe_;
};

}  // namespace vshift::oiio
