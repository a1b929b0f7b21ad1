// SPDX-License-Identifier: Apache-2.0
// Role: words and numbers as a user writes them, and how a message refuses them. Every message has the form
// `file: camera: field: got X, expected Y`; `where` is all before `got`.
#pragma once
#include <string>
#include <vector>

namespace vshift {

/// Throws Error bad_input.
[[noreturn]] void refuse(const std::string& where, const std::string& got, const std::string& expected);

/// Strict, locale-free: the whole text must be one finite number. Throws Error bad_input.
double parse_number(const std::string& text, const std::string& where);
/// The same for a whole number from `lowest` to `highest`; `expected` is said where it is none.
int parse_whole(const std::string& text, int lowest, int highest, const std::string& where,
                const std::string& expected);

/// `text`, or a refusal that names the words and the nearest of them.
const std::string& one_of(const std::string& text, const std::vector<std::string>& words, const std::string& where);
/// The known word nearest to `word` (edit distance), for messages.
std::string nearest_word(const std::string& word, const std::vector<std::string>& known);
std::string list_of(const std::vector<std::string>& words);
/// A short, printable form in quotes.
std::string shown(const std::string& text);

}  // namespace vshift
