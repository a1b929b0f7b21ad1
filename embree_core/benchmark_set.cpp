// SPDX-License-Identifier: Apache-2.0
#include "embree_core/benchmark_set.h"

#include <fcntl.h>
#include <openssl/evp.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <memory>

#include "embree_core/image_file.h"

namespace vshift {
namespace {

using nlohmann::ordered_json;
namespace fs = std::filesystem;

constexpr size_t manifest_limit_bytes = size_t(256) << 20;
constexpr int deepest_nesting = 16;

ordered_json read_manifest(const fs::path& file) {
    ordered_json data;
    const auto refuse = [&](const std::string& text) { throw Error(ExitCode::bad_input, file.string() + ": " + text); };
    const auto shallow = [&](int depth, ordered_json::parse_event_t, ordered_json&) {
        if (depth > deepest_nesting)
            refuse("json: got nesting deeper than " + std::to_string(deepest_nesting) + ", expected a manifest");
        return true;  // dump() recurses
    };
    try {
        data = ordered_json::parse(read_whole_file(file, manifest_limit_bytes), shallow);
    } catch (const nlohmann::json::exception&) {
        throw Error(ExitCode::bad_input, file.string() + ": json: got text that does not parse, expected a manifest");
    }
    if (!data.is_object() || data.value("vshift_manifest", ordered_json()) != 1 || !data.contains("items") ||
        !data["items"].is_object())
        throw Error(ExitCode::bad_input,
                    file.string() + ": vshift_manifest: got something else, expected 1 with items");
    for (const auto& [name, item] : data["items"].items()) {
        if (!item.is_object()) refuse(name + ": item: got " + item.type_name() + ", expected an object");
        for (const char* key : {"status", "sha256"})
            if (item.contains(key) && !item[key].is_string())
                refuse(name + ": " + key + ": got " + item[key].type_name() + ", expected text");
        if (item.contains("bytes") && !item["bytes"].is_number_unsigned())
            refuse(name + ": bytes: got " + item["bytes"].type_name() + ", expected a whole number");
    }
    return data;
}

/// Holds the set's lock (the same file as blender_addon/vshift/manifest.py).
class SetLock {
public:
    explicit SetLock(const fs::path& folder) {
        const fs::path file = folder / ".manifest.lock";
        descriptor_ = ::open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
        if (descriptor_ < 0 || ::flock(descriptor_, LOCK_EX) != 0) {
            const int reason = errno;
            if (descriptor_ >= 0 && reason == EINTR) {
                ::close(descriptor_);
                throw interrupted_error();
            }
            if (descriptor_ >= 0) ::close(descriptor_);
            throw Error(ExitCode::io_failed,
                        file.string() + ": lock: got " + std::strerror(reason) + ", expected to hold it");
        }
    }
    ~SetLock() { ::close(descriptor_); }
    SetLock(const SetLock&) = delete;
    SetLock& operator=(const SetLock&) = delete;

private:
    int descriptor_ = -1;
};

}  // namespace

std::string shift_name(const Shift& shift) {
    const auto part = [](double value) {
        // Hundredths by hand: printf would follow the host's locale.
        const long hundredths = std::lround(std::abs(value) * 100);
        std::string digits = std::to_string(hundredths % 100);
        if (digits.size() < 2) digits.insert(0, "0");
        return std::string(value < 0 && hundredths ? "-" : "+") + std::to_string(hundredths / 100) + "." + digits;
    };
    const glm::dvec3& t = shift.translation_m;
    return "x" + part(t.x) + "_y" + part(t.y) + "_z" + part(t.z) + "_yaw" + part(shift.yaw_rad * degrees_per_radian);
}

fs::path item_path(const std::string& shift, int frame, const std::string& camera) {
    std::string index = std::to_string(frame);
    if (index.size() < 4) index.insert(0, 4 - index.size(), '0');
    return fs::path(shift) / index / (camera + ".exr");
}

namespace {

/// Of what `feed` hands to the function it is given, piece by piece.
template <class Feed>
std::string sha256(Feed feed) {
    const std::unique_ptr<EVP_MD_CTX, void (*)(EVP_MD_CTX*)> digest(EVP_MD_CTX_new(), EVP_MD_CTX_free);
    EVP_DigestInit_ex(digest.get(), EVP_sha256(), nullptr);
    feed([&](const char* data, size_t count) { EVP_DigestUpdate(digest.get(), data, count); });
    unsigned char bytes[EVP_MAX_MD_SIZE];
    unsigned int size = 0;
    EVP_DigestFinal_ex(digest.get(), bytes, &size);
    std::string text;
    for (unsigned int i = 0; i < size; ++i) {
        text += "0123456789abcdef"[bytes[i] >> 4];
        text += "0123456789abcdef"[bytes[i] & 15];
    }
    return text;
}

}  // namespace

std::string sha256_of(const std::string& bytes) {
    return sha256([&](auto add) { add(bytes.data(), bytes.size()); });
}

std::string sha256_of_file(const fs::path& file) {
    const std::unique_ptr<std::FILE, int (*)(std::FILE*)> in(std::fopen(file.c_str(), "rb"), std::fclose);
    if (!in)
        throw Error(ExitCode::io_failed,
                    file.string() + ": file: got " + std::strerror(errno) + ", expected a readable file");
    return sha256([&](auto add) {
        std::vector<char> block(size_t(1) << 20);
        while (const size_t count = std::fread(block.data(), 1, block.size(), in.get())) add(block.data(), count);
        if (std::ferror(in.get()))
            throw Error(ExitCode::io_failed, file.string() + ": file: got a read error, expected its bytes");
    });
}

Manifest::Manifest(const fs::path& set_dir) : folder_(set_dir), data_(read_manifest(set_dir / "manifest.json")) {}

std::vector<NamedShift> Manifest::shifts() const {
    const std::string where = (folder_ / "manifest.json").string() + ": shifts";
    std::vector<NamedShift> out;
    const auto bad = [&] {
        throw Error(ExitCode::bad_input, where + ": got something else, expected a list of {name, shift, yaw_deg}");
    };
    const ordered_json shifts = data_.value("shifts", ordered_json());
    if (!shifts.is_array()) bad();
    for (const ordered_json& s : shifts) {
        if (!s.is_object() || !s.value("name", ordered_json()).is_string() ||
            !s.value("shift", ordered_json()).is_array() || s["shift"].size() != 3)
            bad();
        NamedShift named;
        named.name = s["name"];
        for (int i = 0; i < 3; ++i) {
            if (!s["shift"][size_t(i)].is_number()) bad();
            named.shift.translation_m[i] = s["shift"][size_t(i)];
        }
        if (s.contains("yaw_deg") && !s["yaw_deg"].is_number()) bad();
        named.shift.yaw_rad = s.value("yaw_deg", 0.0) * radians_per_degree;
        const glm::dvec3 t = glm::abs(named.shift.translation_m);
        if (!(std::max({t.x, t.y, t.z}) <= longest_shift_m && std::abs(named.shift.yaw_rad) < 7))
            bad();                                         // as in a request
        if (named.name != shift_name(named.shift)) bad();  // names become folders: only those we make
        out.push_back(named);
    }
    return out;
}

bool Manifest::is_refused(const std::string& item) const {
    const ordered_json& items = data_["items"];
    return items.contains(item) && items[item].value("status", "") == "refused";
}

Shift Manifest::shift_of(const std::string& item, const Shift& named) const {
    const ordered_json& items = data_["items"];
    if (!items.contains(item) || !items[item].contains("moved_to")) return named;
    const ordered_json& place = items[item]["moved_to"];
    Shift moved = named;
    for (size_t i = 0; i < 3; ++i) {
        if (!place.is_array() || place.size() != 3 || !place[i].is_number() ||
            !(std::abs(place[i].get<double>()) <= longest_shift_m))
            throw Error(ExitCode::bad_input, (folder_ / "manifest.json").string() + ": " + item +
                                                 ": moved_to: got something else, expected x,y,z in metres");
        moved.translation_m[int(i)] = place[i];
    }
    return moved;
}

std::string Manifest::made_from(const std::string& request, const std::vector<fs::path>& files) const {
    std::string text = request;
    for (const fs::path& file : files) {
        std::error_code error;
        const std::string name = fs::relative(file, folder_, error).generic_string();
        const ordered_json& items = data_["items"];
        text += " " + name + "=";
        if (items.contains(name) && items[name].contains("sha256")) {
            text += items[name].value("sha256", "").substr(0, 16);
        } else {
            text += std::to_string(fs::file_size(file, error)) + "@";
            text += std::to_string(fs::last_write_time(file, error).time_since_epoch().count());
        }
    }
    return text;
}

bool Manifest::is_done(const std::string& item, const std::string& made_from) const {
    const ordered_json& items = data_["items"];
    if (!items.contains(item) || items[item].value("status", "") != "done") return false;
    if (!made_from.empty() && items[item].value("made_from", "") != made_from) return false;
    std::error_code error;
    const auto bytes = fs::file_size(folder_ / item, error);
    return !error && bytes == items[item].value("bytes", uint64_t(0)) &&
           sha256_of_file(folder_ / item) == items[item].value("sha256", "");
}

void Manifest::record_done(const std::string& item, const std::string& kind, double seconds,
                           const std::string& made_from) {
    ordered_json entry = {{"kind", kind},
                          {"status", "done"},
                          {"sha256", sha256_of_file(folder_ / item)},
                          {"bytes", uint64_t(fs::file_size(folder_ / item))},
                          {"seconds", std::round(seconds * 1000) / 1000}};
    if (!made_from.empty()) entry["made_from"] = made_from;
    const SetLock lock(folder_);
    data_ = read_manifest(folder_ / "manifest.json");
    data_["items"][item] = std::move(entry);
    write_whole_file(folder_ / "manifest.json", data_.dump(1) + "\n");
}

SetCheck check_set(const Manifest& manifest, const std::function<void(size_t, size_t, const std::string&)>& progress) {
    SetCheck result;
    const ordered_json& items = manifest.data()["items"];
    size_t position = 0;
    for (const auto& [name, item] : items.items()) {
        const std::string status = item.is_object() ? item.value("status", "") : "";
        if (status == "done") {
            ++result.done;
            if (!manifest.is_done(name))
                result.faults.push_back((manifest.folder() / name).string() +
                                        ": sha256: got another file or none, expected " +
                                        item.value("sha256", "").substr(0, 12));
        } else if (status == "refused") {
            ++result.refused;
        } else if (status == "planned") {
            ++result.planned;
        } else {
            result.faults.push_back((manifest.folder() / "manifest.json").string() + ": " + name + ": status: got '" +
                                    status + "', expected done, planned or refused");
        }
        progress(++position, items.size(), name);
    }
    return result;
}

}  // namespace vshift
