// SPDX-License-Identifier: Apache-2.0
#include "embree_core/exr_codec.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfIO.h>
#include <ImfInputFile.h>
#include <ImfOutputFile.h>
#include <ImfStringAttribute.h>
#include <ImfThreading.h>
#include <half.h>
#if __has_include(<ImfContextInit.h>)
#include <ImfContextInit.h>  // from OpenEXR 3.3 on
#define VSHIFT_EXR_CONTEXT 1
#endif

#include <algorithm>
#include <cstring>
#include <mutex>
#include <thread>

#include "embree_core/whole_file.h"

namespace vshift::formats {
namespace fs = std::filesystem;
namespace {

/// What stands for no date: OpenImageIO, which wrote our files before and still may, else puts the clock's into a file.
constexpr const char* no_date = " ";

/// OpenImageIO's names for three of OpenEXR's standard attributes, by which users know them.
constexpr std::pair<const char*, const char*> standard_names[] = {
    {"capDate", "DateTime"}, {"comments", "ImageDescription"}, {"owner", "Copyright"}};

class MemoryReader : public Imf::IStream {
public:
    explicit MemoryReader(const std::string& bytes) : IStream("the file"), bytes_(bytes) {}
    bool read(char to[], int count) override {
        if (uint64_t(count) > bytes_.size() - at_) throw std::runtime_error("an early end");
        std::memcpy(to, bytes_.data() + at_, size_t(count));
        at_ += uint64_t(count);
        return at_ < bytes_.size();
    }
    uint64_t tellg() override { return at_; }
    void seekg(uint64_t to) override { at_ = std::min<uint64_t>(to, bytes_.size()); }

private:
    const std::string& bytes_;
    uint64_t at_ = 0;
};

class MemoryWriter : public Imf::OStream {
public:
    MemoryWriter() : OStream("memory") {}
    void write(const char from[], int count) override {
        bytes.resize(std::max(bytes.size(), at_ + size_t(count)));
        std::memcpy(bytes.data() + at_, from, size_t(count));
        at_ += size_t(count);
    }
    uint64_t tellp() override { return at_; }
    void seekp(uint64_t to) override { at_ = size_t(to); }
    std::string bytes;

private:
    size_t at_ = 0;
};

/// OpenEXR's threads while one of these lives. A host may have chosen; else there are none before and none after.
class Threads {
public:
    Threads() {
        const std::lock_guard lock(state);
        if (users++ == 0 && Imf::globalThreadCount() == 0) {
            started = int(std::max(1u, std::thread::hardware_concurrency()));
            Imf::setGlobalThreadCount(started);
        }
    }
    ~Threads() {
        const std::lock_guard lock(state);
        if (--users > 0 || started == 0) return;
        if (Imf::globalThreadCount() == started) Imf::setGlobalThreadCount(0);
        started = 0;
    }
    Threads(const Threads&) = delete;
    Threads& operator=(const Threads&) = delete;
    int count() const { return Imf::globalThreadCount(); }

private:
    static inline std::mutex state;
    static inline int users = 0, started = 0;
};

/// A file to read from memory.
class OpenedFile {
public:
    explicit OpenedFile(const std::string& bytes) : memory_(bytes) {}
    Imf::InputFile& file() { return in_; }

private:
    Threads threads_;
    MemoryReader memory_;
#ifdef VSHIFT_EXR_CONTEXT
    // It prints what it finds wrong, and throws it as well.
    Imf::InputFile in_{"the file",
                       Imf::ContextInitializer().setInputStream(&memory_).setErrorHandler([](exr_const_context_t, exr_result_t, const char*) {}),
                       threads_.count()};
#else
    Imf::InputFile in_{memory_, threads_.count()};
#endif
};

size_t place_of(const std::string& name) {
    const size_t at = std::string("RGBAZ").find(name);
    return name.size() == 1 && at != std::string::npos ? at : 5;
}

std::string reason_of(const std::exception& e) {
    const std::string text = e.what();
    return text.empty() ? "no reason given" : text.substr(0, std::min(text.find('\n'), size_t(200)));
}

/// A plane of `width` whose first pixel is the window's first, which need not be (0, 0): OpenEXR counts from there.
Imf::Slice slice(Imf::PixelType type, void* samples, int width, const Imath::V2i& first = {0, 0}) {
    const size_t size = type == Imf::HALF ? sizeof(half) : sizeof(float);
    const auto before = (int64_t(first.y) * width + first.x) * int64_t(size);
    return {type, static_cast<char*>(samples) - before, size, size * size_t(width)};
}

}  // namespace

void decode_exr(const fs::path& file, const std::string& bytes, const std::vector<std::string>& wanted, Decoded& out) {
    const char* field = "header";
    try {
        OpenedFile opened(bytes);
        Imf::InputFile& in = opened.file();
        const Imath::Box2i window = in.header().dataWindow();
        const int width = window.max.x - window.min.x + 1, height = window.max.y - window.min.y + 1;
        if (width != out.claim.width || height != out.claim.height) throw std::runtime_error("another size from the decoder");
        std::vector<std::string> names;
        for (auto c = in.header().channels().begin(); c != in.header().channels().end(); ++c) names.push_back(c.name());
        std::stable_sort(names.begin(), names.end(),
                         [](const std::string& a, const std::string& b) { return place_of(a) < place_of(b); });
        for (const std::string& name : wanted)
            if (std::find(names.begin(), names.end(), name) == names.end())
                fail_file(ExitCode::bad_input, file, "channel", unknown_channel(name, names));
        if (!wanted.empty())
            std::erase_if(names, [&](const std::string& n) { return std::find(wanted.begin(), wanted.end(), n) == wanted.end(); });
        check_limits(file, width, height, int64_t(names.size()));
        out.image.names = names;
        out.image.planes.assign(names.size(), std::vector<float>(size_t(width) * size_t(height)));
        Imf::FrameBuffer frame;
        for (size_t c = 0; c < names.size(); ++c)
            frame.insert(names[c], slice(Imf::FLOAT, out.image.planes[c].data(), width, window.min));
        field = "pixels";
        in.setFrameBuffer(frame);
        in.readPixels(window.min.y, window.max.y);
        for (auto a = in.header().begin(); a != in.header().end(); ++a) {
            const auto* text = dynamic_cast<const Imf::StringAttribute*>(&a.attribute());
            std::string key = a.name();
            for (const auto& [theirs, ours] : standard_names)
                if (key == theirs) key = ours;
            if (text && !is_encoding_key(key) && !(key == "DateTime" && text->value() == no_date))
                out.image.metadata[key] = text->value();
        }
    } catch (const Error&) {
        throw;
    } catch (const std::bad_alloc&) {
        throw;
    } catch (const std::exception& e) {
        fail_file(ExitCode::bad_input, file, field, "got " + reason_of(e) + ", expected a whole file");
    }
}

std::string encode_exr(const fs::path& file, const Channels& image, const std::vector<SampleType>& types) {
    try {
        Imf::Header header(image.width, image.height);
        header.compression() = Imf::ZIP_COMPRESSION;
        header.insert("capDate", Imf::StringAttribute(no_date));
        for (const auto& [key, value] : image.metadata) {
            if (value.empty() || is_encoding_key(key)) continue;
            std::string name = key;
            for (const auto& [theirs, ours] : standard_names)
                if (key == ours) name = theirs;
            header.insert(name, Imf::StringAttribute(value));
        }
        Imf::FrameBuffer frame;
        std::vector<std::vector<half>> halves;
        halves.reserve(types.size());
        for (size_t c = 0; c < types.size(); ++c) {
            const bool small = types[c] == SampleType::float16;
            header.channels().insert(image.names[c], Imf::Channel(small ? Imf::HALF : Imf::FLOAT));
            if (small) {
                halves.emplace_back(image.planes[c].begin(), image.planes[c].end());
                frame.insert(image.names[c], slice(Imf::HALF, halves.back().data(), image.width));
            } else {
                frame.insert(image.names[c], slice(Imf::FLOAT, const_cast<float*>(image.planes[c].data()), image.width));
            }
        }
        MemoryWriter memory;
        {
            const Threads threads;
            Imf::OutputFile out(memory, header, threads.count());
            out.setFrameBuffer(frame);
            out.writePixels(image.height);
        }
        return std::move(memory.bytes);
    } catch (const std::bad_alloc&) {
        throw;
    } catch (const std::exception& e) {
        fail_file(ExitCode::io_failed, file, "encoding", "got " + reason_of(e) + ", expected a whole file");
    }
}

}  // namespace vshift::formats
