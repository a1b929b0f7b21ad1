// SPDX-License-Identifier: Apache-2.0
// Role: safetensors files in and out, one file or sharded behind an index. Stage: inpaint (weights). No Torch here.
//
// Files are mapped, not read: opening touches the headers alone. Nothing in a file is believed: header length,
// JSON, types, shapes, offsets and shard names are checked before use, and a tensor's bytes lie inside its file.
// Pickles (.pt, .pth, .bin) and TorchScript run code when they are loaded: they are refused by name. A file that
// shrinks while it is mapped ends the process (SIGBUS), as with every mapped file.
#pragma once
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "embree_core/types.h"

namespace vshift::inpaint {

enum class ElementType : uint8_t { boolean, u8, i8, i16, i32, i64, f16, bf16, f32, f64 };
size_t bytes_of(ElementType type);
const char* name_of(ElementType type);  ///< as in the file: BOOL, U8, I8, I16, I32, I64, F16, BF16, F32, F64

using Shape = std::vector<int64_t>;
std::string text_of(const Shape& shape);  ///< "[8, 3, 3]"

/// Row-major, little-endian; `data` need not be aligned.
struct StoredTensor {
    std::string name;
    ElementType type = ElementType::f32;
    Shape shape;
    const uint8_t* data = nullptr;
    size_t bytes = 0;
};

/// Largest header that is taken, its most tensors and dimensions (the 5-billion-parameter model has 0.1 MB and 825).
inline constexpr size_t max_header_bytes = size_t(8) << 20;
inline constexpr size_t max_tensors = 65536;
inline constexpr size_t max_dimensions = 8;

struct TensorDirectory {
    std::vector<StoredTensor> tensors;            ///< sorted by name
    std::map<std::string, std::string> metadata;  ///< the `__metadata__` object
};

/// The directory of a whole file in memory; `file` names it in messages. Throws Error bad_input, or over_limit.
TensorDirectory parse_tensor_file(std::string_view bytes, const std::string& file);

/// One file, or all shards that a `*.index.json` names; a folder stands for the one of both that lies in it.
class TensorFiles {
public:
    /// Throws Error: io_failed when a file cannot be read, bad_input for what it holds.
    explicit TensorFiles(const std::filesystem::path& path);
    ~TensorFiles();
    TensorFiles(TensorFiles&&) noexcept;
    TensorFiles& operator=(TensorFiles&&) noexcept;

    const std::string& file() const { return file_; }  ///< as named in messages
    const std::vector<StoredTensor>& tensors() const { return directory_.tensors; }
    const std::map<std::string, std::string>& metadata() const { return directory_.metadata; }
    const StoredTensor* find(const std::string& name) const;

private:
    struct Mapping;
    void add_file(const std::filesystem::path& file);
    void add_shards(const std::filesystem::path& index);

    std::string file_;
    std::vector<std::unique_ptr<Mapping>> mappings_;
    TensorDirectory directory_;
};

/// The file's bytes: tensors in the order of their names, data aligned to 8 bytes. Same input, same bytes.
std::string encode_tensor_file(std::vector<StoredTensor> tensors, const std::map<std::string, std::string>& metadata);
/// Whole or not at all (image_file.h). Throws Error io_failed; our_bug when names repeat or bytes do not fit shapes.
void write_tensor_file(const std::filesystem::path& file, const std::vector<StoredTensor>& tensors,
                       const std::map<std::string, std::string>& metadata);

/// FNV-1a over names, types, shapes and bytes, in the order of the names: tells whether weights have changed.
uint64_t hash_of(std::vector<StoredTensor> tensors);

}  // namespace vshift::inpaint
