// SPDX-License-Identifier: Apache-2.0
#include "embree_core/words.h"

#include <algorithm>
#include <charconv>
#include <cmath>

#include "embree_core/types.h"

namespace vshift {

void refuse(const std::string& where, const std::string& got, const std::string& expected) {
    throw Error(ExitCode::bad_input, where + ": got " + got + ", expected " + expected);
}

double parse_number(const std::string& text, const std::string& where) {
    double value = 0;
    const bool plus = text.size() > 1 && text[0] == '+' && text[1] != '-';  // from_chars takes no plus
    const char* begin = text.data() + plus;
    const auto [end, error] = std::from_chars(begin, text.data() + text.size(), value);
    if (error != std::errc() || end != text.data() + text.size() || text.empty() || !std::isfinite(value))
        refuse(where, shown(text), "a finite number");
    return value;
}

int parse_whole(const std::string& text, int lowest, int highest, const std::string& where,
                const std::string& expected) {
    int value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc() || end != text.data() + text.size() || value < lowest || value > highest)
        refuse(where, shown(text), expected);
    return value;
}

const std::string& one_of(const std::string& text, const std::vector<std::string>& words, const std::string& where) {
    if (std::find(words.begin(), words.end(), text) == words.end())
        refuse(where, shown(text), "one of " + list_of(words) + " (did you mean " + nearest_word(text, words) + "?)");
    return text;
}

std::string nearest_word(const std::string& word, const std::vector<std::string>& known) {
    std::string best;
    size_t best_distance = std::string::npos;
    for (const std::string& candidate : known) {
        std::vector<size_t> row(candidate.size() + 1);
        for (size_t j = 0; j < row.size(); ++j) row[j] = j;
        for (size_t i = 0; i < std::min<size_t>(word.size(), 64); ++i) {
            size_t diagonal = row[0];
            row[0] = i + 1;
            for (size_t j = 0; j < candidate.size(); ++j) {
                const size_t replaced = diagonal + (word[i] != candidate[j]);
                diagonal = row[j + 1];
                row[j + 1] = std::min({replaced, row[j] + 1, row[j + 1] + 1});
            }
        }
        if (row.back() < best_distance) {
            best_distance = row.back();
            best = candidate;
        }
    }
    return best;
}

std::string list_of(const std::vector<std::string>& words) {
    std::string text;
    for (const std::string& word : words) text += (text.empty() ? "" : ", ") + word;
    return text;
}

std::string shown(const std::string& text) {
    std::string out = "'";
    for (char c : text.substr(0, 60)) out += static_cast<unsigned char>(c) < 32 || c == 127 ? '?' : c;
    return out + (text.size() > 60 ? "...'" : "'");
}

}  // namespace vshift
