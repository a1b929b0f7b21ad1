// SPDX-License-Identifier: Apache-2.0
#include "oiio_plugin/answer_cache.h"

#include <malloc.h>
#include <sys/stat.h>
#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>

namespace vshift::oiio {
namespace {

/// What tells one state of a file from another, whatever the name that leads to it. A file that is not there has a
/// stamp too.
std::string stamp(const std::filesystem::path& file) {
    struct stat s = {};
    if (stat(file.c_str(), &s) != 0) return file.string() + "|none\n";
    char text[160];
    std::snprintf(text, sizeof text, "%llu %llu %lld %lld.%09ld %lld.%09ld\n", (unsigned long long)s.st_dev,
                  (unsigned long long)s.st_ino, (long long)s.st_size, (long long)s.st_mtim.tv_sec, s.st_mtim.tv_nsec,
                  (long long)s.st_ctim.tv_sec, s.st_ctim.tv_nsec);
    return text;
}

size_t bytes_of(const Answer& answer) {
    size_t bytes = sizeof(Answer);
    for (const auto& plane : answer.image.planes) bytes += plane.size() * sizeof(float);
    return bytes;
}

/// Runs `work` so that the waiting thread takes on no tasks of the host, which might come back here, and lets TBB's
/// worker threads end when nobody else in the process uses them.
template <class Work>
void compute_apart(const Work& work) {
    tbb::task_scheduler_handle scheduler{tbb::attach{}};
    tbb::this_task_arena::isolate(work);
    tbb::finalize(scheduler, std::nothrow);
}

std::vector<std::pair<std::string, std::string>> parse_query(const std::string& query, const std::string& where) {
    std::vector<std::pair<std::string, std::string>> pairs;
    for (size_t begin = 0; begin < query.size();) {
        const size_t end = std::min(query.find('&', begin), query.size());
        const std::string part = query.substr(begin, end - begin);
        const size_t equals = part.find('=');
        if (equals == std::string::npos || equals == 0)
            throw Error(ExitCode::bad_input, where + ": query: got '" + part + "', expected key=value");
        pairs.emplace_back(part.substr(0, equals), part.substr(equals + 1));
        begin = end + 1;
    }
    return pairs;
}

}  // namespace

std::shared_ptr<const Recipe> AnswerCache::recipe(const std::string& file) {
    const std::string now = stamp(file);
    {
        const std::lock_guard lock(state_);
        if (recipe_ && recipe_stamp_ == now) return recipe_;
    }
    auto loaded = std::make_shared<const Recipe>(load_recipe(file));
    const std::lock_guard lock(state_);
    recipe_stamp_ = now;
    return recipe_ = loaded;
}

std::vector<SharedAnswer> AnswerCache::answers(const std::string& recipe_file, const std::string& query,
                                               const std::vector<std::pair<std::string, std::string>>& defaults) {
    const std::string recipe_stamp = stamp(recipe_file);
    const auto parsed = recipe(recipe_file);
    auto pairs = parse_query(query, recipe_file);
    for (const auto& [key, text] : defaults) {
        const bool asked = std::any_of(pairs.begin(), pairs.end(), [&](const auto& pair) { return pair.first == key; });
        if (!asked) pairs.emplace_back(key, text);
    }
    Request request = resolve_request(*parsed, pairs);
    FrameFiles files(*parsed);
    std::vector<SharedAnswer> found;
    for (const std::string& camera : requested_cameras(*parsed, request)) {
        request.camera = camera;
        found.push_back(one(*parsed, recipe_stamp, request, files));
    }
    return found;
}

SharedAnswer AnswerCache::one(const Recipe& recipe, const std::string& recipe_stamp, const Request& request,
                              FrameFiles& files) {
    const std::string asked = canonical_text(request);
    std::string key = recipe_stamp + asked + "\n";
    for (const auto& file : input_files(recipe, request)) key += stamp(file);
    if (SharedAnswer known = find(key)) return known;
    const std::lock_guard computing(computing_);
    if (SharedAnswer known = find(key)) return known;  // another thread was first

    const auto start = std::chrono::steady_clock::now();
    SharedAnswer made;
    compute_apart([&] { made = std::make_shared<const Answer>(answer(recipe, request, files)); });
    keep(key, made);
    static const bool log = std::getenv("VSHIFT_LOG") != nullptr;
    if (log) {
        const std::chrono::duration<double, std::milli> took = std::chrono::steady_clock::now() - start;
        const std::lock_guard lock(state_);
        std::fprintf(stderr, "vshift: computed %s of %s in %.0f ms, cache %.1f of %.1f MB\n", asked.c_str(),
                     recipe.file.c_str(), took.count(), double(kept_bytes_) / (1 << 20),
                     double(limit_bytes_) / (1 << 20));
    }
    return made;
}

SharedAnswer AnswerCache::find(const std::string& key) {
    const std::lock_guard lock(state_);
    const auto place = places_.find(key);
    if (place == places_.end()) return nullptr;
    entries_.splice(entries_.begin(), entries_, place->second);
    return place->second->answer;
}

void AnswerCache::keep(const std::string& key, const SharedAnswer& answer) {
    const std::lock_guard lock(state_);
    const size_t bytes = bytes_of(*answer) + key.size();
    if (bytes > limit_bytes_) return;
    drop_to(limit_bytes_ - bytes);
    entries_.push_front({key, answer, bytes});
    places_[key] = entries_.begin();
    kept_bytes_ += bytes;
}

void AnswerCache::set_limit(size_t bytes) {
    const std::lock_guard lock(state_);
    limit_bytes_ = bytes;
    drop_to(bytes);
}

void AnswerCache::drop_to(size_t limit_bytes) {
    const bool drops = kept_bytes_ > limit_bytes;
    while (kept_bytes_ > limit_bytes) {
        kept_bytes_ -= entries_.back().bytes;
        places_.erase(entries_.back().key);
        entries_.pop_back();
    }
#ifdef __GLIBC__
    // Small things that a host keeps between our planes would else hold the whole heap: 2 MB for each answer.
    if (drops) malloc_trim(0);
#endif
}

}  // namespace vshift::oiio
