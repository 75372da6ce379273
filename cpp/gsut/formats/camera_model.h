// Reads and writes the text of mrcal's .cameramodel files.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "gsut/cameras/camera.h"

namespace gsut {

// A lens file. Pixels are in gsut's convention, (0.5, 0.5) the centre of the top-left pixel; mrcal
// has (0, 0) there, and the half pixel is added and taken off here.
struct CameraModelFile {
  Camera camera;
  // Rodrigues rotation and translation camera_from_reference; kept as it is.
  std::array<double, 6> extrinsics = {};
  // Polygon of pixels inside which mrcal trusts its intrinsics; empty: nowhere. Kept, not applied.
  std::optional<std::vector<std::array<double, 2>>> valid_region;
};

// Models: LENSMODEL_PINHOLE, _OPENCV4, _OPENCV5, _OPENCV8, _OPENCV12, _STEREOGRAPHIC, _LONLAT,
// _LATLON, _CAHVOR, _CAHVORE, _SPLINED_STEREOGRAPHIC. The key gsut_valid_field_angle (radians),
// which mrcal does not know, holds Camera::valid_field_angle; mrcal's optimization_inputs are not
// read. source: the file's name, for messages. Throws CalibrationError naming source, line and key.
CameraModelFile ParseCameraModel(std::string_view text, const std::string& source);

// Throws InputError if mrcal has no such lens. Numbers are written so that they read back exactly.
std::string FormatCameraModel(const CameraModelFile& file);

}  // namespace gsut
