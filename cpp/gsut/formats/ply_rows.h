// The rows of one element of a PLY file as doubles, whatever format, order and types it has.
#pragma once

#include <cstdint>
#include <functional>
#include <istream>
#include <string>

#include "gsut/formats/ply_header.h"

namespace gsut {

// Throws InputError if the rest of the stream, which is positioned behind the header, is too short
// for the rows that the header announces: a broken count is found before memory is allocated.
void CheckPlySize(std::istream& stream, const std::string& path, const PlyHeader& header);

// Calls row(values) for each row of element `index`, values[i] being property i (of a list: 0; the
// entries are passed over). The stream stands behind the header; the elements before are skipped.
// Throws InputError naming path and row if the data ends early or, in ascii, a value is no number.
// Every numeric type of PLY is exact in double.
void ReadPlyRows(std::istream& stream, const std::string& path, const PlyHeader& header,
                 std::size_t index, const std::function<void(const double* values)>& row);

}  // namespace gsut
