// SPDX-License-Identifier: Apache-2.0
// Role: the OpenImageIO plugin vshift.imageio.so. It reads `FILE.vshift?key=value&key=value` as an image:
// the answer that the command line gives to the same request. docs/oiiotool.md shows its use.
#include <OpenImageIO/imageio.h>
#include <link.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <mutex>
#include <new>
#include <numeric>
#include <set>
#include <sstream>

#include "embree_core/printable.h"
#include "embree_core/words.h"
#include "oiio_plugin/answer_cache.h"

namespace vshift::oiio {
namespace {

constexpr const char* extension = ".vshift";

size_t cache_bytes(const std::string& megabytes, const std::string& where) {
    const double value = parse_number(megabytes, where);
    if (!(value >= 0 && value <= 1e6))
        throw Error(ExitCode::bad_input, where + ": got '" + megabytes + "', expected megabytes from 0 to 1000000");
    return size_t(value * (1 << 20));
}

/// Lives as long as the process: OIIO never unloads a plugin, and may still read while others end.
AnswerCache& cache() {
    static AnswerCache* const instance = [] {
        auto* made = new AnswerCache;
        if (const char* text = std::getenv("VSHIFT_CACHE_MB")) {
            try {
                made->set_limit(cache_bytes(text, "VSHIFT_CACHE_MB"));
            } catch (const Error& e) {
                std::fprintf(stderr, "vshift: %s; 1024 is used\n", e.what());
            }
        }
        return made;
    }();
    return *instance;
}

/// `street.vshift?camera=A` is the recipe and the query; false for a name of another kind.
bool split_name(const std::string& name, std::string& recipe_file, std::string& query) {
    const size_t mark = name.find('?');
    recipe_file = name.substr(0, mark);
    query = mark == std::string::npos ? "" : name.substr(mark + 1);
    const size_t length = std::strlen(extension);
    return recipe_file.size() > length && recipe_file.compare(recipe_file.size() - length, length, extension) == 0;
}

/// oiiotool 2.4 and 2.5 say only "File does not exist" of a query that fails: the reason goes to the terminal
/// too, once.
void tell(const std::string& message) {
    static std::mutex mutex;
    static auto* const told = new std::set<std::string>;
    const std::lock_guard lock(mutex);
    if (told->size() < 1000 && told->insert(message).second) std::fprintf(stderr, "vshift: %s\n", message.c_str());
}

/// The four rows of a metadata string `m00 m01 ...` for column vectors, as OIIO keeps a matrix: for row vectors.
bool matrix_of(const std::string& text, float (&matrix)[16]) {
    std::istringstream in(text);
    in.imbue(std::locale::classic());
    for (int row = 0; row < 4; ++row)
        for (int column = 0; column < 4; ++column)
            if (!(in >> matrix[column * 4 + row])) return false;
    return true;
}

/// Positions of the channels in the order in which OIIO gives those of an EXR (colours, Z, then by name), so that an
/// answer and the command line's file of it compare channel by channel.
std::vector<size_t> channel_order(const std::vector<std::string>& names) {
    std::vector<size_t> order(names.size());
    std::iota(order.begin(), order.end(), size_t(0));
    const auto rank = [&](size_t c) { return std::pair(std::string("RGBAZ").find(names[c]), names[c]); };
    std::sort(order.begin(), order.end(), [&](size_t a, size_t b) { return rank(a) < rank(b); });
    return order;
}

OIIO::ImageSpec spec_of(const Answer& answer) {
    const Channels& image = answer.image;
    OIIO::ImageSpec spec(image.width, image.height, int(image.names.size()), OIIO::TypeFloat);
    spec.channelnames.clear();
    spec.alpha_channel = -1;
    spec.z_channel = -1;
    for (const size_t c : channel_order(image.names)) {
        if (image.names[c] == "Z") spec.z_channel = int(spec.channelnames.size());
        spec.channelnames.push_back(image.names[c]);
    }
    for (const auto& [name, text] : image.metadata) spec.attribute(name, text);
    if (const auto camera = image.metadata.find("vshift.camera"); camera != image.metadata.end())
        spec.attribute("oiio:subimagename", camera->second);
    float matrix[16];
    if (const auto text = image.metadata.find("vshift.worldToCamera");
        text != image.metadata.end() && matrix_of(text->second, matrix))
        spec.attribute("worldtocamera", OIIO::TypeMatrix, matrix);
    return spec;
}

class VshiftInput final : public OIIO::ImageInput {
public:
    ~VshiftInput() override { close(); }
    const char* format_name() const override { return "vshift"; }

    int supports(OIIO::string_view feature) const override {
        // Before 3.1.17 oiiotool aborts when a procedural input fails to open.
        return feature == "procedural" && OIIO::openimageio_version() >= 30117;
    }

    bool valid_file(const std::string& name) const override {
        std::string recipe_file, query;
        std::error_code error;
        return split_name(name, recipe_file, query) && std::filesystem::is_regular_file(recipe_file, error);
    }

    bool open(const std::string& name, OIIO::ImageSpec& spec) override { return open(name, spec, OIIO::ImageSpec()); }

    bool open(const std::string& name, OIIO::ImageSpec& spec, const OIIO::ImageSpec& config) override {
        std::string recipe_file, query;
        if (!split_name(name, recipe_file, query)) {  // first of all: OIIO may hold a lock and offers any file
            errorfmt("{}: got another kind of file, expected a .vshift recipe", name);
            return false;
        }
        const lock_guard lock(*this);
        std::string reason;
        try {
            answers_ = cache().answers(recipe_file, query, from_config(config));
            subimage_ = 0;
            m_spec = spec_of(*answers_.at(0));
            spec = m_spec;
            return true;
        } catch (const std::bad_alloc&) {
            reason = recipe_file + ": memory: got none, expected enough for the request";
        } catch (const std::exception& e) {
            reason = e.what();
        } catch (...) {
            reason = recipe_file + ": internal: got an unknown exception, expected none (please report this)";
        }
        answers_.clear();
        reason = printable(reason);
        errorfmt("{}", reason);
        if (name.size() != recipe_file.size()) tell(reason);
        return false;
    }

    bool close() override {
        answers_.clear();
        subimage_ = 0;
        return true;
    }

    int current_subimage() const override {
        const lock_guard lock(*this);
        return subimage_;
    }

    bool seek_subimage(int subimage, int miplevel) override {
        const lock_guard lock(*this);
        if (miplevel != 0 || subimage < 0 || size_t(subimage) >= answers_.size()) return false;
        if (subimage == subimage_) return true;
        m_spec = spec_of(*answers_[size_t(subimage)]);
        subimage_ = subimage;
        return true;
    }

    bool read_native_scanline(int subimage, int miplevel, int y, int z, void* data) override {
        return read_native_scanlines(subimage, miplevel, y, y + 1, z, data);
    }

    bool read_native_scanlines(int subimage, int miplevel, int ybegin, int yend, int z, void* data) override {
        const lock_guard lock(*this);
        if (!seek_subimage(subimage, miplevel)) return false;
        return read_native_scanlines(subimage, miplevel, ybegin, yend, z, 0, m_spec.nchannels, data);
    }

    bool read_native_scanlines(int subimage, int miplevel, int ybegin, int yend, int, int chbegin, int chend,
                               void* data) override {
        const lock_guard lock(*this);
        if (!seek_subimage(subimage, miplevel)) return false;
        const Channels& image = answers_[size_t(subimage)]->image;
        if (ybegin < 0 || ybegin > yend || yend > image.height || chbegin < 0 || chbegin >= chend ||
            chend > int(image.names.size())) {
            errorfmt("{}: scanlines: got rows {} to {}, channels {} to {}, expected them within the image",
                     m_spec.get_string_attribute("vshift.camera"), ybegin, yend, chbegin, chend);
            return false;
        }
        const size_t first = size_t(ybegin) * size_t(image.width), count = size_t(yend - ybegin) * size_t(image.width);
        const size_t channels = size_t(chend - chbegin);
        const std::vector<size_t> order = channel_order(image.names);
        auto* out = static_cast<float*>(data);
        for (size_t c = 0; c < channels; ++c) {
            const float* plane = image.planes[order[size_t(chbegin) + c]].data() + first;
            for (size_t i = 0; i < count; ++i) out[i * channels + c] = plane[i];
        }
        return true;
    }

private:
    /// `vshift:shift` and so on in an open's configuration (OIIO's `format:hint`) are the request's defaults.
    static std::vector<std::pair<std::string, std::string>> from_config(const OIIO::ImageSpec& config) {
        std::vector<std::pair<std::string, std::string>> defaults;
        for (const auto& attribute : config.extra_attribs) {
            const std::string name = attribute.name().string();
            if (name.rfind("vshift:", 0) != 0) continue;
            if (name == "vshift:cache_mb")
                cache().set_limit(cache_bytes(attribute.get_string(), name));
            else
                defaults.emplace_back(name.substr(std::strlen("vshift:")), attribute.get_string());
        }
        return defaults;
    }

    std::vector<SharedAnswer> answers_;  // one per subimage
    int subimage_ = 0;
};

/// Another OpenImageIO beside the one that this was built for would mix their classes.
bool is_only_openimageio() {
    int count = 0;
    dl_iterate_phdr(
        [](dl_phdr_info* info, size_t, void* data) {
            *static_cast<int*>(data) += std::strstr(info->dlpi_name, "libOpenImageIO.so") != nullptr;
            return 0;
        },
        &count);
    return count <= 1;
}

}  // namespace
}  // namespace vshift::oiio

#define VSHIFT_TEXT_(x) #x
#define VSHIFT_TEXT(x) VSHIFT_TEXT_(x)

// What OIIO looks up; exports.map hides all else.
#pragma GCC visibility push(default)
extern "C" {
/// A version that no host has makes OIIO pass this plugin by.
int vshift_imageio_version = vshift::oiio::is_only_openimageio() ? OIIO_PLUGIN_VERSION : -1;
extern const char vshift_imageio_built_for[];
const char vshift_imageio_built_for[] = "vshift.imageio " VSHIFT_VERSION " built for OpenImageIO " OIIO_VERSION_STRING;
const char* vshift_imageio_library_version() {
    return vshift_imageio_built_for;
}
OIIO::ImageInput* vshift_input_imageio_create() {
    return new vshift::oiio::VshiftInput;
}
extern const char* vshift_input_extensions[];
const char* vshift_input_extensions[] = {"vshift", nullptr};
}
#pragma GCC visibility pop
