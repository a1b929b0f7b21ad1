// SPDX-License-Identifier: Apache-2.0
// Role: the self-check of an installed OpenImageIO plugin, `vshift check --plugin [FOLDER_OR_FILE]`.
// OpenImageIO says nothing of a plugin that it cannot load; this says what is wrong and what to do.
//
// One line per step on standard output, `ok   what: found` or `FAIL what: got X, expected Y: do Z`:
//
//   where      the argument, else the folders on OpenImageIO's path, else ../lib beside this program.
//              The path is OIIO_LIBRARY_PATH; from OpenImageIO 2.6.3 on also OPENIMAGEIO_PLUGIN_PATH,
//              after it. Fails when the plugin's folder is not on it, or another plugin comes first.
//   file       a regular, readable, whole shared object for this machine, named vshift.imageio.so
//              (OpenImageIO takes the format's name from the file's).
//   built for  the versions of vshift and OpenImageIO that the plugin names in its own bytes.
//   libraries  the system's loader in its listing mode, as ldd uses it, in a process of its own: names
//              every missing library, version or symbol at once, honours the plugin's RUNPATH and runs
//              none of its code. dlopen here would name only the first, and take what this program has
//              loaded, its own OpenImageIO too, for what oiiotool will find.
//   oiiotool   on PATH, and of the minor version that the plugin was built for.
//   loads      `oiiotool --list-formats` lists vshift when given that folder alone.
//   answers    oiiotool's mask of a recipe of a few pixels is that of the library, value for value.
//
// A failure that makes the rest meaningless ends the check; the others (where, libraries, another vshift)
// do not hide what comes after. Programs are started without a shell, for 20 s at most; a crash of theirs
// is reported. The temporary folder of the last step is removed.
#pragma once
#include <string>

namespace vshift::cli {

/// `given` is a folder, a file, or empty. Throws Error for the first step that failed: io_failed when a
/// file cannot be read or is not there, else bad_input. Takes the plugin paths out of this process's own
/// environment, so that its OpenImageIO does not load what is judged: no other work should follow.
void check_plugin(const std::string& given);

}  // namespace vshift::cli
