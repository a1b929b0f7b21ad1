// SPDX-License-Identifier: Apache-2.0
#include "embree_core/cli/plugin_check.h"

#include <elf.h>
#include <link.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <optional>
#include <vector>

#include "embree_core/answer.h"
#include "embree_core/cli/run_program.h"
#include "embree_core/version.h"
#include "embree_core/whole_file.h"

namespace vshift::cli {
namespace {

namespace fs = std::filesystem;
using Version = std::array<int, 3>;

const std::string plugin_name = "vshift.imageio.so";
const std::string path_variable = "OIIO_LIBRARY_PATH", newer_path_variable = "OPENIMAGEIO_PLUGIN_PATH";

std::string text_of(const Version& v, size_t parts = 3) {
    std::string text = std::to_string(v[0]);
    for (size_t i = 1; i < parts; ++i) text += "." + std::to_string(v[i]);
    return text;
}

bool same_minor(const Version& a, const Version& b) {
    return a[0] == b[0] && a[1] == b[1];
}

/// Prints the steps as they come and keeps those that failed.
class Steps {
public:
    void ok(const std::string& what, const std::string& found) { print("ok   " + what + ": " + found); }
    void fail(const std::string& what, const std::string& got, const std::string& expected, const std::string& remedy,
              ExitCode code = ExitCode::bad_input) {
        const std::string line = what + ": got " + got + ", expected " + expected + ": do " + remedy;
        print("FAIL " + line);
        failed_.emplace_back(code, "plugin: " + line);
    }
    template <class... Parts>
    [[noreturn]] void stop(const Parts&... parts) {
        fail(parts...);
        throw_worst();
    }
    size_t failed() const { return failed_.size(); }
    /// Throws when any step failed.
    void end() const {
        if (!failed_.empty()) throw_worst();
    }

private:
    [[noreturn]] void throw_worst() const {
        for (const Error& e : failed_)
            if (e.code() == ExitCode::io_failed) throw e;
        throw failed_.front();
    }
    static void print(std::string line) {
        for (char& c : line)
            if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) c = '?';
        std::printf("%s\n", line.c_str());
        std::fflush(stdout);
    }
    std::vector<Error> failed_;
};

const std::string reinstall = "install the plugin and this program anew, from one build";

// ---- where --------------------------------------------------------------------------------------------

struct Oiiotool {
    std::string program;             ///< empty: not on PATH
    std::optional<Version> version;  ///< null: it did not say
    std::string problem;             ///< what it did instead
};

Oiiotool find_oiiotool() {
    Oiiotool found;
    found.program = program_on_path("oiiotool");
    if (found.program.empty()) return found;
    // Without any plugin, which might crash it. Before 2.4 there is no --version, but the help names it.
    for (const bool help : {false, true}) {
        const ProgramRun run = run_program({found.program, help ? "--help" : "--version"},
                                           {path_variable + "=", newer_path_variable + "="});
        const size_t at = help ? run.output.find("OpenImageIO ") : 0;
        const char* pattern = help ? "OpenImageIO %d.%d.%d" : "%d.%d.%d";
        Version v;
        if (run.code == 0 && at != std::string::npos &&
            std::sscanf(run.output.c_str() + at, pattern, &v[0], &v[1], &v[2]) == 3) {
            found.version = v;
            break;
        }
        if (!help) found.problem = run.told();
    }
    return found;
}

Words folders_of(const std::string& variable) {
    const char* value = std::getenv(variable.c_str());
    return split(value ? value : "", ":;");  // OpenImageIO takes both, on every system
}

/// For a shell, quoted where it has to be.
std::string quoted(const std::string& text) {
    const bool plain = std::all_of(text.begin(), text.end(), [](char c) {
        return std::isalnum(static_cast<unsigned char>(c)) || std::strchr("/._-+,@%", c);
    });
    std::string out;
    for (char c : text) out += c == '\'' ? std::string("'\\''") : std::string(1, c);
    return plain ? text : "'" + out + "'";
}

/// The plugin to look at, absolute.
fs::path find_plugin(const std::string& given, const Oiiotool& host, Steps& steps) {
    std::error_code error;
    Words variables = {path_variable};
    if (host.version && *host.version >= Version{2, 6, 3}) variables.push_back(newer_path_variable);
    std::vector<fs::path> on_path;  // in the order in which OpenImageIO tries them: the first that loads wins
    for (const std::string& variable : variables)
        for (const std::string& folder : folders_of(variable))
            if (fs::exists(fs::path(folder) / plugin_name, error)) on_path.push_back(fs::path(folder) / plugin_name);

    fs::path plugin = fs::read_symlink("/proc/self/exe", error).parent_path().parent_path() / "lib" / plugin_name;
    std::string source = "beside this program";
    if (!given.empty()) {
        plugin = fs::is_directory(given, error) ? fs::path(given) / plugin_name : fs::path(given);
        source = "as given";
    } else if (!on_path.empty()) {
        plugin = on_path[0];
        source = "on the path";
    }
    plugin = fs::absolute(plugin, error).lexically_normal();
    const std::string name = plugin.string() + " (" + source + ")";
    if (!fs::exists(fs::symlink_status(plugin, error)))
        steps.stop("where", "no " + name, "the plugin", "build it, or name its folder", ExitCode::io_failed);

    const std::string folder = plugin.parent_path().string();
    const bool set = !folders_of(path_variable).empty();
    const std::string remedy =
        "export " + path_variable + "=" + quoted(folder) + (set ? ":\"$" + path_variable + "\"" : "");
    const fs::path same = fs::canonical(plugin, error);
    const auto is_this = [&](const fs::path& file) { return fs::canonical(file, error) == same; };
    const auto listed = std::find_if(on_path.begin(), on_path.end(), is_this);
    if (folder.find_first_of(":;") != std::string::npos)
        steps.fail("where", name, "a folder without ':' and ';', which separate those of " + path_variable, "move it");
    else if (listed == on_path.end())
        steps.fail("where", path_variable + (set ? " without the folder" : " not set") + " for " + name,
                   "it to name the folder", remedy);
    else if (listed != on_path.begin())
        steps.fail("where", on_path[0].string() + " first on the path, so it wins", plugin.string(), remedy);
    else {
        std::string others;
        for (const fs::path& file : on_path)
            if (!is_this(file)) others += (others.empty() ? ", wins over " : ", ") + file.string();
        steps.ok("where", name + others);
    }
    return plugin;
}

// ---- file, built for, libraries -----------------------------------------------------------------------

using FileHeader = ElfW(Ehdr);
using Segment = ElfW(Phdr);

std::optional<FileHeader> header_of(const std::string& bytes) {
    FileHeader header;
    if (bytes.size() < sizeof header || bytes.compare(0, SELFMAG, ELFMAG) != 0) return std::nullopt;
    std::memcpy(&header, bytes.data(), sizeof header);
    return header;
}

std::string machine_of(const FileHeader& header) {
    return std::to_string(header.e_machine) + (header.e_ident[EI_CLASS] == ELFCLASS64 ? ", 64 bits" : ", 32 bits") +
           (header.e_ident[EI_DATA] == ELFDATA2LSB ? "" : ", big-endian");
}

/// Where the file must at least end, by its own tables; the section table is the last thing in it.
uint64_t stated_end(const FileHeader& header, const std::string& bytes) {
    uint64_t end = uint64_t(header.e_shoff) + uint64_t(header.e_shnum) * header.e_shentsize;
    for (uint64_t i = 0; i < header.e_phnum; ++i) {
        const uint64_t at = uint64_t(header.e_phoff) + i * sizeof(Segment);
        end = std::max(end, at + sizeof(Segment));
        if (at > bytes.size() || bytes.size() - at < sizeof(Segment)) break;
        Segment segment;
        std::memcpy(&segment, bytes.data() + at, sizeof segment);
        end = std::max(end, uint64_t(segment.p_offset) + uint64_t(segment.p_filesz));
    }
    return end;
}

/// The plugin's bytes.
std::string read_plugin(const fs::path& plugin, Steps& steps) {
    std::string bytes;
    try {
        bytes = read_whole_file(plugin, size_t(1) << 30);
    } catch (const Error& e) {
        steps.stop("file", "'" + std::string(e.what()) + "'", "a file that can be read", "install it anew", e.code());
    }
    const std::string size = std::to_string(bytes.size()) + " bytes";
    const auto header = header_of(bytes);
    if (!header) steps.stop("file", size + " of something else", "an ELF shared object", "install it anew");
    const auto own = header_of(RegularFile("/proc/self/exe").read_first(sizeof(FileHeader)));
    if (own && machine_of(*header) != machine_of(*own))
        steps.stop("file", "ELF machine " + machine_of(*header), machine_of(*own) + " as this program's",
                   "build the plugin on this machine");
    if (const uint64_t end = stated_end(*header, bytes); end > bytes.size())
        steps.stop("file", size, "at least " + std::to_string(end) + " (it is cut short)", "install it anew");
    if (header->e_type != ET_DYN)
        steps.stop("file", "ELF type " + std::to_string(header->e_type), "a shared object", "install it anew");
    if (plugin.filename() != plugin_name)
        steps.stop("file", "the name " + plugin.filename().string(),
                   plugin_name + ", by which OpenImageIO knows the format", "rename it");
    steps.ok("file", "a shared object for this machine, " + size);
    return bytes;
}

/// The version of OpenImageIO that the plugin was built for, out of its bytes:
/// `vshift.imageio 0.1.0 built for OpenImageIO 2.4.7`. Other texts in it may begin in the same way.
Version read_built_for(const std::string& bytes, Steps& steps) {
    const std::string lead = "vshift.imageio ";
    for (size_t at = bytes.find(lead); at != std::string::npos; at = bytes.find(lead, at + 1)) {
        Version own, host;
        if (std::sscanf(bytes.substr(at, 100).c_str(), "vshift.imageio %d.%d.%d built for OpenImageIO %d.%d.%d",
                        &own[0], &own[1], &own[2], &host[0], &host[1], &host[2]) != 6)
            continue;
        if (text_of(own) == version_string)
            steps.ok("built for", "OpenImageIO " + text_of(host) + ", as part of vshift " + text_of(own));
        else
            steps.fail("built for", "vshift " + text_of(own), std::string(version_string) + " as this program's",
                       reinstall);
        return host;
    }
    steps.stop("built for", "no version in the file", "the mark of a vshift plugin", "install it anew");
}

/// The loader that started this program and will start oiiotool.
std::string loader_path() {
    std::string path;
    dl_iterate_phdr(
        [](dl_phdr_info* info, size_t, void* out) {
            for (int i = 0; i < info->dlpi_phnum; ++i)
                if (info->dlpi_phdr[i].p_type == PT_INTERP)
                    *static_cast<std::string*>(out) =
                        reinterpret_cast<const char*>(info->dlpi_addr + info->dlpi_phdr[i].p_vaddr);
            return 1;  // the first is the program itself
        },
        &path);
    return path;
}

bool check_libraries(const fs::path& plugin, Steps& steps) {
    const ProgramRun run =
        run_program({loader_path(), plugin.string()}, {"LD_TRACE_LOADED_OBJECTS=1", "LD_WARN=yes", "LD_BIND_NOW=yes"});
    const auto holds = [](const std::string& text, const char* part) { return text.find(part) != std::string::npos; };
    std::vector<std::string> missing, symbols;
    int found = 0;
    for (std::string line : split(run.output, "\n")) {
        std::replace(line.begin(), line.end(), '\t', ' ');
        for (const std::string& lead : {plugin.string() + ": ", std::string("undefined ")})
            if (line.compare(0, lead.size(), lead) == 0) line.erase(0, lead.size());
        const size_t begin = std::min(line.find_first_not_of(' '), line.size());
        const std::string name = line.substr(begin, line.find(" => ", begin) - begin);
        if (holds(line, "not found"))
            missing.push_back(name);
        else if (holds(line, "symbol: "))
            symbols.push_back(name);
        else
            found += holds(line, " => ");
    }
    if (missing.empty()) missing = symbols;  // else they are what the missing libraries hold
    std::string list;
    for (size_t i = 0; i < std::min<size_t>(missing.size(), 5); ++i) list += (i ? "; " : "") + missing[i];
    if (missing.size() > 5) list += "; " + std::to_string(missing.size() - 5) + " more";
    if (!missing.empty())
        steps.fail("libraries", "missing " + list, "every library, version and symbol",
                   holds(list, "OpenImageIO") ? "build the plugin against the OpenImageIO at hand"
                                              : "install them, or build the plugin on this machine");
    else if (run.code != 0)
        steps.fail("libraries", run.told() + " from the loader", "a list of libraries", "install the plugin anew");
    else
        steps.ok("libraries", "all " + std::to_string(found) + " found");
    return missing.empty() && run.code == 0;
}

// ---- oiiotool, loads, answers -------------------------------------------------------------------------

bool check_oiiotool(const Oiiotool& host, const Version& built_for, Steps& steps) {
    const bool fits = host.version && same_minor(*host.version, built_for);
    if (host.program.empty())
        steps.fail("oiiotool", "none on PATH", "one of OpenImageIO " + text_of(built_for, 2),
                   "install it (Debian: openimageio-tools) or extend PATH");
    else if (!host.version)
        steps.fail("oiiotool", host.problem + " from " + host.program, "its version", "install it anew");
    else if (!fits)
        steps.fail("oiiotool", "OpenImageIO " + text_of(*host.version) + " (" + host.program + ")",
                   text_of(built_for, 2) + " that the plugin was built for",
                   "build the plugin against " + text_of(*host.version, 2) + " or put another oiiotool first on PATH");
    else
        steps.ok("oiiotool", host.program + ", OpenImageIO " + text_of(*host.version));
    return fits;
}

void check_loads(const Oiiotool& host, const Words& only_it, Steps& steps) {
    const ProgramRun run = run_program({host.program, "--list-formats"}, only_it);
    for (const std::string& line : split(run.output, "\n"))
        if (run.code == 0 && line.find("vshift : ") != std::string::npos)
            return steps.ok("loads", "oiiotool lists the format");
    if (run.code == 0)
        steps.stop("loads", "a list without vshift", "vshift among oiiotool's formats",
                   "build the plugin against the OpenImageIO at hand");
    steps.stop("loads", run.told() + " from oiiotool --list-formats", "a list of formats",
               "build the plugin anew, on this machine");
}

/// A folder of its own, removed with all that it holds.
struct TemporaryFolder {
    fs::path path;
    TemporaryFolder() {
        std::error_code error;
        std::string name = (fs::temp_directory_path(error) / "vshift-check-XXXXXX").string();
        if (!error && !::mkdtemp(name.data())) error.assign(errno, std::generic_category());
        if (error) fail_file(ExitCode::io_failed, name, "folder", "got " + error.message() + ", expected to make it");
        path = name;
    }
    ~TemporaryFolder() {
        std::error_code error;
        fs::remove_all(path, error);
    }
};

constexpr int width = 24, height = 16;
constexpr const char* recipe_text = R"({"vshift": 1, "cameras": [{"name": "A", "width": 24, "height": 16,
 "intrinsic": [[24, 0, 12], [0, 24, 8], [0, 0, 1]], "rotation": [0.5, -0.5, 0.5, -0.5], "translation": [0, 0, 1],
 "depth": "depth.pfm"}], "frames": [{"index": 0, "timestamp_s": 0, "rotation": [1, 0, 0, 0], "translation": [0, 0, 0]}]})";

/// A box at 2 m before a wall at 6 m, and a pixel without a measurement.
void check_answers(const Oiiotool& host, const Words& only_it, Steps& steps) {
    const TemporaryFolder folder;
    Channels depth;
    depth.width = width;
    depth.height = height;
    depth.add("Z", std::vector<float>(size_t(width * height), 6.f));
    for (int y = 5; y < 11; ++y)
        for (int x = 10; x < 15; ++x) depth.planes[0][size_t(y * width + x)] = 2.f;
    depth.planes[0][30] = 0.f;
    write_image(folder.path / "depth.pfm", depth);
    write_whole_file(folder.path / "tiny.vshift", recipe_text);
    const ProgramRun run = run_program(
        {host.program, "tiny.vshift?camera=A&shift=0,0.5,0", "-d", "float", "-o", "mask.exr"}, only_it, folder.path);
    if (run.code != 0) steps.stop("answers", run.told() + " from oiiotool", "a mask", reinstall);

    // This program's own OpenImageIO reads the mask: it must not load plugins. Version 2 looks into the last as well.
    for (const std::string& variable : {path_variable, newer_path_variable, std::string("LD_LIBRARY_PATH")})
        ::unsetenv(variable.c_str());
    const Channels got = read_image(folder.path / "mask.exr");
    const Recipe recipe = load_recipe(folder.path / "tiny.vshift");
    FrameFiles files(recipe);
    const Channels expected =
        answer(recipe, resolve_request(recipe, {{"camera", "A"}, {"shift", "0,0.5,0"}}), files).image;
    if (got.width != width || got.height != height || got.names.size() != expected.names.size())
        steps.stop("answers", std::to_string(got.names.size()) + " channels or another size",
                   std::to_string(expected.names.size()) + " of this program's size", reinstall);
    size_t differing = 0, set = 0;
    for (const std::string& name : expected.names)
        for (size_t i = 0; i < size_t(width * height); ++i) {
            const float value = expected.plane(name)[i];
            set += value != 0;
            differing += !got.has(name) || got.plane(name)[i] != value;
        }
    const std::string count = std::to_string(expected.names.size() * size_t(width * height));
    if (differing)
        steps.stop("answers", std::to_string(differing) + " of " + count + " values that differ", "this program's mask",
                   reinstall);
    steps.ok("answers",
             "the same mask as this program's, " + count + " values, " + std::to_string(set) + " of them set");
}

}  // namespace

void check_plugin(const std::string& given) {
    Steps steps;
    const Oiiotool host = find_oiiotool();
    const fs::path plugin = find_plugin(given, host, steps);
    const Version built_for = read_built_for(read_plugin(plugin, steps), steps);
    const bool loadable = check_libraries(plugin, steps);
    if (!check_oiiotool(host, built_for, steps) || !loadable) steps.end();
    const Words only_it = {path_variable + "=" + plugin.parent_path().string(), newer_path_variable + "="};
    check_loads(host, only_it, steps);
    const size_t failed = steps.failed();
    try {
        check_answers(host, only_it, steps);
    } catch (const Error& e) {  // a file of ours, or of oiiotool's, that could not be written or read
        if (steps.failed() > failed || e.code() == ExitCode::interrupted) throw;
        steps.stop("answers", "'" + std::string(e.what()) + "'", "masks to compare", "mend that first", e.code());
    }
    steps.end();
}

}  // namespace vshift::cli
