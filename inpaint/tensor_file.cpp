// SPDX-License-Identifier: Apache-2.0
#include "inpaint/tensor_file.h"

#include <sys/mman.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <nlohmann/json.hpp>
#include <set>

#include "embree_core/image_file.h"
#include "embree_core/whole_file.h"

namespace vshift::inpaint {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

struct TypeRow {
    ElementType type;
    const char* name;
    size_t bytes;
};
constexpr std::array<TypeRow, 10> type_rows{{{ElementType::boolean, "BOOL", 1},
                                             {ElementType::u8, "U8", 1},
                                             {ElementType::i8, "I8", 1},
                                             {ElementType::i16, "I16", 2},
                                             {ElementType::i32, "I32", 4},
                                             {ElementType::i64, "I64", 8},
                                             {ElementType::f16, "F16", 2},
                                             {ElementType::bf16, "BF16", 2},
                                             {ElementType::f32, "F32", 4},
                                             {ElementType::f64, "F64", 8}}};

const TypeRow& row_of(ElementType type) {
    return type_rows[size_t(type)];
}

[[noreturn]] void refuse(const std::string& file, const std::string& field, const std::string& got,
                         const std::string& expected, ExitCode code = ExitCode::bad_input) {
    // Names come from the file: no message longer than a line or two.
    fail_file(code, file, field.substr(0, 200), "got " + got.substr(0, 200) + ", expected " + expected);
}

/// JSON with duplicate keys and nesting deeper than a header's refused.
json parse_json(std::string_view text, const std::string& file, int deepest) {
    std::vector<std::set<std::string>> keys;
    const auto callback = [&](int depth, json::parse_event_t event, json& parsed) {
        if (depth > deepest) refuse(file, "header", "deeper nesting than " + std::to_string(deepest), "a flat object");
        if (event == json::parse_event_t::object_start) keys.emplace_back();
        if (event == json::parse_event_t::object_end) keys.pop_back();
        if (event == json::parse_event_t::key)
            if (const auto& key = parsed.get_ref<const std::string&>(); !keys.back().insert(key).second)
                refuse(file, key, "the key twice", "it once");
        return true;
    };
    try {
        return json::parse(text.begin(), text.end(), callback);
    } catch (const json::exception& e) {
        std::string reason = e.what();
        if (const size_t end = reason.find("] "); end != std::string::npos) reason = reason.substr(end + 2);
        refuse(file, "header", reason.substr(0, 120), "valid JSON");
    }
}

/// What loads by running code, told by its first bytes.
void refuse_code(std::string_view bytes, const std::string& file) {
    const auto starts = [&](std::string_view with) { return bytes.substr(0, with.size()) == with; };
    // A header of safetensors may be 0x80 + 256 n bytes long too: then come zeros and a brace.
    const bool header = bytes.size() > 8 && bytes.substr(3, 5) == std::string_view("\0\0\0\0\0", 5) && bytes[8] == '{';
    const bool pickle = !header && bytes.size() > 1 && uint8_t(bytes[0]) == 0x80 && uint8_t(bytes[1]) <= 5;
    if (starts("PK\x03\x04") || pickle)
        refuse(file, "format", pickle ? "a pickle" : "a zip archive (a pickled .pt or TorchScript)",
               "safetensors (loading a pickle runs code of its author; convert it where you trust it)");
    if (starts("GGUF")) refuse(file, "format", "GGUF", "safetensors");
    if (starts("version https://git-lfs"))
        refuse(file, "format", "a Git LFS pointer", "the safetensors file itself (git lfs pull)");
}

/// A tensor's entry; its offsets are relative to `data`.
StoredTensor parse_entry(const std::string& name, const json& entry, std::string_view data, const std::string& file,
                         std::pair<uint64_t, uint64_t>& range) {
    StoredTensor t;
    t.name = name;
    if (!entry.is_object() || entry.size() != 3 || !entry.contains("dtype") || !entry.contains("shape") ||
        !entry.contains("data_offsets"))
        refuse(file, name, entry.dump(-1, ' ', true, json::error_handler_t::replace).substr(0, 80),
               "an object of dtype, shape and data_offsets");
    const json& type = entry["dtype"];
    const auto row = std::find_if(type_rows.begin(), type_rows.end(),
                                  [&](const TypeRow& r) { return type.is_string() && type == r.name; });
    if (row == type_rows.end())
        refuse(file, name + ": dtype", type.dump(-1, ' ', true, json::error_handler_t::replace).substr(0, 40),
               "one of BOOL, U8, I8, I16, I32, I64, F16, BF16, F32, F64");
    t.type = row->type;

    const json& shape = entry["shape"];
    if (!shape.is_array() || shape.size() > max_dimensions)
        refuse(file, name + ": shape", shape.is_array() ? std::to_string(shape.size()) + " dimensions" : "no list",
               "at most " + std::to_string(max_dimensions) + " dimensions");
    uint64_t bytes = row->bytes;
    for (const json& side : shape) {
        if (!side.is_number_unsigned() || side.get<uint64_t>() > uint64_t(INT64_MAX))
            refuse(file, name + ": shape", side.dump(-1, ' ', true, json::error_handler_t::replace).substr(0, 40),
                   "whole numbers from 0");
        const uint64_t n = side.get<uint64_t>();
        if (__builtin_mul_overflow(bytes, n, &bytes))
            refuse(file, name + ": shape", "more than 2^64 bytes", "the tensor's size");
        t.shape.push_back(int64_t(n));
    }
    const json& offsets = entry["data_offsets"];
    if (!offsets.is_array() || offsets.size() != 2 || !offsets[0].is_number_unsigned() ||
        !offsets[1].is_number_unsigned())
        refuse(file, name + ": data_offsets", "something else", "two whole numbers");
    range = {offsets[0].get<uint64_t>(), offsets[1].get<uint64_t>()};
    if (range.first > range.second || range.second > data.size())
        refuse(file, name + ": data_offsets",
               "[" + std::to_string(range.first) + ", " + std::to_string(range.second) + "]",
               "a range within the file's " + std::to_string(data.size()) + " data bytes");
    if (range.second - range.first != bytes)
        refuse(file, name + ": data_offsets", std::to_string(range.second - range.first) + " bytes",
               std::to_string(bytes) + " for shape " + text_of(t.shape) + " of " + row->name);
    t.data = reinterpret_cast<const uint8_t*>(data.data()) + range.first;
    t.bytes = size_t(bytes);
    return t;
}

void sort_by_name(std::vector<StoredTensor>& tensors) {
    std::sort(tensors.begin(), tensors.end(),
              [](const StoredTensor& a, const StoredTensor& b) { return a.name < b.name; });
}

}  // namespace

size_t bytes_of(ElementType type) {
    return row_of(type).bytes;
}
const char* name_of(ElementType type) {
    return row_of(type).name;
}

std::string text_of(const Shape& shape) {
    std::string text = "[";
    for (size_t i = 0; i < shape.size(); ++i) text += (i ? ", " : "") + std::to_string(shape[i]);
    return text + "]";
}

TensorDirectory parse_tensor_file(std::string_view bytes, const std::string& file) {
    refuse_code(bytes, file);
    if (bytes.size() < 10) refuse(file, "size", std::to_string(bytes.size()) + " bytes", "a safetensors file");
    uint64_t header_bytes = 0;
    for (int i = 7; i >= 0; --i) header_bytes = header_bytes << 8 | uint8_t(bytes[size_t(i)]);
    if (header_bytes > bytes.size() - 8)
        refuse(file, "header", std::to_string(header_bytes) + " bytes",
               "at most the " + std::to_string(bytes.size() - 8) + " that follow (is it safetensors, and whole?)");
    if (header_bytes > max_header_bytes)
        refuse(file, "header", std::to_string(header_bytes) + " bytes", "at most " + std::to_string(max_header_bytes),
               ExitCode::over_limit);
    const std::string_view header = bytes.substr(8, size_t(header_bytes)), data = bytes.substr(8 + size_t(header_bytes));
    if (header.empty() || header[0] != '{') refuse(file, "header", "no object", "JSON that begins with {");
    const json root = parse_json(header, file, 3);
    if (!root.is_object()) refuse(file, "header", "no object", "a JSON object");
    if (root.size() > max_tensors + 1)
        refuse(file, "header", std::to_string(root.size()) + " tensors", "at most " + std::to_string(max_tensors),
               ExitCode::over_limit);

    TensorDirectory out;
    std::vector<std::pair<std::pair<uint64_t, uint64_t>, const std::string*>> ranges;
    for (const auto& [name, entry] : root.items()) {
        if (name == "__metadata__") {
            if (!entry.is_object()) refuse(file, name, "no object", "an object of strings");
            for (const auto& [key, value] : entry.items()) {
                if (!value.is_string()) refuse(file, name + ": " + key, value.type_name(), "a string");
                out.metadata[key] = value.get<std::string>();
            }
            continue;
        }
        std::pair<uint64_t, uint64_t> range;
        out.tensors.push_back(parse_entry(name, entry, data, file, range));
        ranges.emplace_back(range, nullptr);
        ranges.back().second = &root.find(name).key();
    }
    // Every data byte belongs to exactly one tensor: nothing overlaps, nothing is smuggled along.
    std::sort(ranges.begin(), ranges.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
    uint64_t end = 0;
    for (const auto& [range, name] : ranges) {
        if (range.first != end)
            refuse(file, *name + ": data_offsets", "a start at " + std::to_string(range.first),
                   "data without gap or overlap, here from " + std::to_string(end));
        end = range.second;
    }
    if (end != data.size())
        refuse(file, "size", std::to_string(data.size()) + " data bytes", std::to_string(end) + " that belong to tensors");
    sort_by_name(out.tensors);
    return out;
}

struct TensorFiles::Mapping {
    void* address = MAP_FAILED;
    size_t bytes = 0;

    explicit Mapping(const fs::path& file) {
        const RegularFile source(file);
        bytes = size_t(source.size());
        if (bytes == 0) refuse(file.string(), "size", "0 bytes", "a safetensors file");
        address = ::mmap(nullptr, bytes, PROT_READ, MAP_PRIVATE, source.descriptor(), 0);
        if (address == MAP_FAILED)
            refuse(file.string(), "reading", std::string(std::strerror(errno)), "a file that can be mapped",
                   ExitCode::io_failed);
    }
    ~Mapping() {
        if (address != MAP_FAILED) ::munmap(address, bytes);
    }
    Mapping(const Mapping&) = delete;
    Mapping& operator=(const Mapping&) = delete;
    std::string_view view() const { return {static_cast<const char*>(address), bytes}; }
};

TensorFiles::TensorFiles(const fs::path& path) : file_(path.string()) {
    std::error_code error;
    fs::path file = path;
    if (fs::is_directory(path, error)) {
        fs::path found;
        for (const char* stem : {"model", "diffusion_pytorch_model"})
            for (const char* ending : {".safetensors.index.json", ".safetensors"})
                if (found.empty() && fs::exists(path / (std::string(stem) + ending), error))
                    found = path / (std::string(stem) + ending);
        if (found.empty())
            refuse(file_, "folder", "no model.safetensors and no model.safetensors.index.json", "one of them");
        file = found;
        file_ = found.string();
    }
    if (file.extension() == ".json")
        add_shards(file);
    else
        add_file(file);
    sort_by_name(directory_.tensors);
}
TensorFiles::~TensorFiles() = default;
TensorFiles::TensorFiles(TensorFiles&&) noexcept = default;
TensorFiles& TensorFiles::operator=(TensorFiles&&) noexcept = default;

void TensorFiles::add_file(const fs::path& file) {
    auto mapping = std::make_unique<Mapping>(file);
    TensorDirectory directory = parse_tensor_file(mapping->view(), file.string());
    mappings_.push_back(std::move(mapping));
    std::move(directory.tensors.begin(), directory.tensors.end(), std::back_inserter(directory_.tensors));
    directory_.metadata.merge(directory.metadata);
}

void TensorFiles::add_shards(const fs::path& index) {
    const std::string text = read_whole_file(index, max_header_bytes);
    refuse_code(text, file_);
    const json root = parse_json(text, file_, 3);
    if (!root.is_object() || !root.contains("weight_map") || !root["weight_map"].is_object())
        refuse(file_, "weight_map", "none", "an object of tensor names and shard files");
    std::map<std::string, std::vector<std::string>> names_of;
    for (const auto& [name, shard] : root["weight_map"].items()) {
        if (!shard.is_string()) refuse(file_, name, shard.type_name(), "the name of a shard");
        const std::string file = shard.get<std::string>();
        // A shard lies beside its index, nowhere else.
        if (file.empty() || file.find('/') != std::string::npos || file.find('\0') != std::string::npos ||
            fs::path(file).extension() != ".safetensors")
            refuse(file_, name, file, "a .safetensors file beside the index");
        names_of[file].push_back(name);
    }
    if (names_of.size() > 1024)
        refuse(file_, "weight_map", std::to_string(names_of.size()) + " shards", "at most 1024", ExitCode::over_limit);
    for (auto& [shard, names] : names_of) {
        const size_t before = directory_.tensors.size();
        const fs::path path = index.parent_path() / shard;
        add_file(path);
        std::sort(names.begin(), names.end());
        const auto begin = directory_.tensors.begin() + long(before), end = directory_.tensors.end();
        const auto has = [&](const std::string& name) {
            const auto at = std::lower_bound(begin, end, name,
                                             [](const StoredTensor& t, const std::string& n) { return t.name < n; });
            return at != end && at->name == name;
        };
        for (const std::string& name : names)
            if (!has(name)) refuse(path.string(), name, "no such tensor", "it, for the index names this shard");
        for (auto at = begin; at != end; ++at)
            if (!std::binary_search(names.begin(), names.end(), at->name))
                refuse(path.string(), at->name, "a tensor that the index does not place here", "only those it does");
    }
}

const StoredTensor* TensorFiles::find(const std::string& name) const {
    const auto& all = directory_.tensors;
    const auto at = std::lower_bound(all.begin(), all.end(), name,
                                     [](const StoredTensor& t, const std::string& n) { return t.name < n; });
    return at != all.end() && at->name == name ? &*at : nullptr;
}

std::string encode_tensor_file(std::vector<StoredTensor> tensors, const std::map<std::string, std::string>& metadata) {
    sort_by_name(tensors);
    nlohmann::ordered_json root = nlohmann::ordered_json::object();
    if (!metadata.empty()) root["__metadata__"] = metadata;
    uint64_t end = 0;
    for (const StoredTensor& t : tensors) {
        uint64_t bytes = bytes_of(t.type);
        for (const int64_t n : t.shape) bytes *= uint64_t(n);
        if (bytes != t.bytes || t.name == "__metadata__" || root.contains(t.name))
            throw Error(ExitCode::our_bug, "tensor " + t.name + ": got " + std::to_string(t.bytes) +
                                               " bytes or its name twice, expected " + std::to_string(bytes));
        root[t.name] = {{"dtype", name_of(t.type)}, {"shape", t.shape}, {"data_offsets", {end, end + bytes}}};
        end += bytes;
    }
    std::string header = root.dump();
    header.resize((header.size() + 7) / 8 * 8, ' ');
    std::string out;
    out.reserve(8 + header.size() + size_t(end));
    for (int i = 0; i < 8; ++i) out += char(uint8_t(uint64_t(header.size()) >> (8 * i)));
    out += header;
    for (const StoredTensor& t : tensors) out.append(reinterpret_cast<const char*>(t.data), t.bytes);
    return out;
}

void write_tensor_file(const fs::path& file, const std::vector<StoredTensor>& tensors,
                       const std::map<std::string, std::string>& metadata) {
    write_whole_file(file, encode_tensor_file(tensors, metadata));
}

uint64_t hash_of(std::vector<StoredTensor> tensors) {
    sort_by_name(tensors);
    uint64_t hash = 14695981039346656037ull;
    const auto add = [&](const void* data, size_t bytes) {
        const auto* at = static_cast<const uint8_t*>(data);
        for (size_t i = 0; i < bytes; ++i) hash = (hash ^ at[i]) * 1099511628211ull;
    };
    for (const StoredTensor& t : tensors) {
        const std::string head = t.name + " " + name_of(t.type) + " " + text_of(t.shape);
        add(head.c_str(), head.size() + 1);
        add(t.data, t.bytes);
    }
    return hash;
}

}  // namespace vshift::inpaint
