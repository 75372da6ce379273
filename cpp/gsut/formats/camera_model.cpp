// Reads and writes mrcal's .cameramodel files.
#include "gsut/formats/camera_model.h"

#include <charconv>
#include <cmath>
#include <cstdio>
#include <limits>
#include <sstream>
#include <system_error>

#include "gsut/base/errors.h"
#include "gsut/formats/camera_model_literal.h"

namespace gsut {
namespace {

using Kind = PythonLiteral::Kind;

// mrcal's pixel (0, 0) is gsut's (0.5, 0.5).
constexpr double kPixelShift = 0.5;
constexpr const char* kFieldAngleKey = "gsut_valid_field_angle";

struct ModelName {
  const char* mrcal;
  const char* gsut;
};
// The parameters are the same, in the same order.
constexpr ModelName kModels[] = {
    {"LENSMODEL_PINHOLE", "pinhole"},   {"LENSMODEL_OPENCV4", "opencv4"},
    {"LENSMODEL_OPENCV5", "opencv5"},   {"LENSMODEL_OPENCV8", "opencv8"},
    {"LENSMODEL_OPENCV12", "opencv12"}, {"LENSMODEL_STEREOGRAPHIC", "stereographic"},
    {"LENSMODEL_LONLAT", "lonlat"},     {"LENSMODEL_LATLON", "latlon"},
    {"LENSMODEL_CAHVOR", "cahvor"},
};
// Lenses whose configuration stands in the name (order=3_Nx=30_Ny=18_fov_x_deg=150); in gsut it is
// the first parameters, or the last.
struct ConfiguredName {
  const char* mrcal;
  const char* gsut;
  std::vector<const char*> keys;
  bool is_first;
};
// A function, as a global of vectors would be made in an order that the linker chooses.
const std::vector<ConfiguredName>& ConfiguredModels() {
  static const std::vector<ConfiguredName> models = {
      {"LENSMODEL_SPLINED_STEREOGRAPHIC",
       "splined_stereographic",
       {"order", "Nx", "Ny", "fov_x_deg"},
       true},
      {"LENSMODEL_CAHVORE", "cahvore", {"linearity"}, false},
  };
  return models;
}

// For messages: the names that would have been read.
std::string KnownModels() {
  std::string known;
  for (const ModelName& model : kModels) known += std::string(model.mrcal) + ", ";
  for (const ConfiguredName& model : ConfiguredModels()) known += std::string(model.mrcal) + ", ";
  return known.substr(0, known.size() - 2);
}

// The values that follow `model.mrcal` in a name; false if they are not what the model needs.
// All keys must be there, in this order, and nothing behind them.
bool ParseConfig(const ConfiguredName& model, const std::string& name,
                 std::vector<double>* config) {
  std::size_t position = std::string_view(model.mrcal).size();
  for (const char* key : model.keys) {
    const std::string wanted = std::string("_").append(key).append("=");
    if (name.compare(position, wanted.size(), wanted) != 0) return false;
    position += wanted.size();
    double value = 0.0;
    const auto [end, error] =
        std::from_chars(name.data() + position, name.data() + name.size(), value);
    if (error != std::errc()) return false;
    config->push_back(value);
    position = static_cast<std::size_t>(end - name.data());
  }
  return position == name.size();
}

// The lens of a name, and the parameters that the name holds, before and after the intrinsics;
// false if it is unknown.
bool ParseName(const std::string& name, std::string* lens, std::vector<double>* first,
               std::vector<double>* last) {
  for (const ModelName& model : kModels) {
    if (name != model.mrcal) continue;
    *lens = model.gsut;
    return true;
  }
  for (const ConfiguredName& model : ConfiguredModels()) {
    if (name.rfind(std::string(model.mrcal) + "_", 0) != 0) continue;
    *lens = model.gsut;
    return ParseConfig(model, name, model.is_first ? first : last);
  }
  return false;
}

// The file's dictionary with checked access to its keys.
// Every access says what it expected and where, so that a broken file names its own line.
class Reader {
 public:
  Reader(const PythonLiteral& root, const std::string& source) : root_(root), source_(source) {}

  // Errors name the file, the line and the key, as calibration files are edited by hand.
  [[noreturn]] void Fail(const std::string& key, int line, const std::string& problem) const {
    throw CalibrationError(source_ + ", line " + std::to_string(line) + ", key '" + key +
                           "': " + problem);
  }

  const PythonLiteral& Get(const std::string& key) const {
    const PythonLiteral* value = root_.Find(key);
    if (value == nullptr) {
      throw CalibrationError(source_ + ", line " + std::to_string(root_.line) + ": key '" + key +
                             "' is missing; a .cameramodel file needs lensmodel, intrinsics, "
                             "extrinsics and imagersize");
    }
    return *value;
  }

  void Expect(const std::string& key, const PythonLiteral& value, Kind kind) const {
    if (value.kind == kind) return;
    Fail(key, value.line,
         std::string("expected ") + KindName(kind) + ", found " + KindName(value.kind));
  }

  double Number(const std::string& key, const PythonLiteral& value) const {
    Expect(key, value, Kind::kNumber);
    return value.number;
  }

  // count < 0: any number.
  std::vector<double> Numbers(const std::string& key, const PythonLiteral& list, int count) const {
    Expect(key, list, Kind::kList);
    if (count >= 0 && list.items.size() != static_cast<std::size_t>(count)) {
      Fail(key, list.line,
           "expected " + std::to_string(count) + " numbers, found " +
               std::to_string(list.items.size()));
    }
    std::vector<double> numbers;
    numbers.reserve(list.items.size());
    for (const PythonLiteral& item : list.items) numbers.push_back(Number(key, item));
    return numbers;
  }

  // A size must be a whole number: 1e3 is one, 1000.5 is a mistake.
  int Pixels(const std::string& key, const PythonLiteral& list, double number) const {
    if (number >= 1.0 && number <= std::numeric_limits<int>::max() &&
        number == std::floor(number)) {
      return static_cast<int>(number);
    }
    std::ostringstream message;
    message << "expected two positive whole numbers, found " << number;
    Fail(key, list.line, message.str());
  }

  // The lens, and the parameters that its name holds, before and after the intrinsics.
  std::string Model(std::vector<double>* first, std::vector<double>* last) const {
    const PythonLiteral& name = Get("lensmodel");
    Expect("lensmodel", name, Kind::kString);
    std::string lens;
    if (ParseName(name.text, &lens, first, last)) return lens;
    Fail("lensmodel", name.line,
         "'" + name.text + "' is not a lens of gsut; supported: " + KnownModels() +
             "; fit one of them with mrcal-convert-lensmodel");
  }

  // Parameters in gsut's order: configuration, intrinsics, configuration. cx and cy, the third and
  // fourth intrinsic of each of these lenses, are shifted to gsut's pixel origin.
  Camera ReadCamera() const {
    std::vector<double> params, last;
    const std::string model = Model(&params, &last);
    const PythonLiteral& size_list = Get("imagersize");
    const std::vector<double> size = Numbers("imagersize", size_list, 2);
    const int width = Pixels("imagersize", size_list, size[0]);
    const int height = Pixels("imagersize", size_list, size[1]);
    const PythonLiteral& intrinsics = Get("intrinsics");
    std::vector<double> numbers = Numbers("intrinsics", intrinsics, -1);
    if (numbers.size() >= 4) {
      numbers[2] += kPixelShift;
      numbers[3] += kPixelShift;
    }
    // A wrong number of parameters is reported by the lens itself, with its parameters' names.
    params.insert(params.end(), numbers.begin(), numbers.end());
    params.insert(params.end(), last.begin(), last.end());
    // gsut's own key limits the field where calibration saw nothing; mrcal ignores keys it does not
    // know.
    double field_angle = kInfinity;
    if (const PythonLiteral* limit = root_.Find(kFieldAngleKey)) {
      field_angle = Number(kFieldAngleKey, *limit);
    }
    try {
      return Camera(model, std::move(params), width, height, field_angle);
    } catch (const InputError& error) {
      Fail("intrinsics", intrinsics.line, error.what());
    }
  }

  // mrcal's polygon of pixels inside which the calibration is to be trusted.
  std::optional<std::vector<std::array<double, 2>>> ValidRegion() const {
    constexpr const char* kKey = "valid_intrinsics_region";
    const PythonLiteral* list = root_.Find(kKey);
    if (list == nullptr || list->kind == Kind::kNone) return std::nullopt;
    Expect(kKey, *list, Kind::kList);
    std::vector<std::array<double, 2>> region;
    for (const PythonLiteral& item : list->items) {
      const std::vector<double> pixel = Numbers(kKey, item, 2);
      region.push_back({pixel[0] + kPixelShift, pixel[1] + kPixelShift});
    }
    return region;
  }

 private:
  const PythonLiteral& root_;
  const std::string& source_;
};

// (std::to_chars promises that, and does not depend on the locale.)
// The shortest text that reads back as the same double.
std::string Text(double value) {
  constexpr std::size_t kLongest = 64;  // a double has at most 24 characters
  char buffer[kLongest];
  const auto [end, error] = std::to_chars(buffer, buffer + sizeof(buffer), value);
  return error == std::errc() ? std::string(buffer, end) : std::to_string(value);
}

// mrcal ends lists with a comma; Python takes it.
template <class Values>
std::string ListText(const Values& values) {
  std::string text = "[ ";
  for (const double value : values) text += Text(value) + ", ";
  return text + "]";
}

}  // namespace

CameraModelFile ParseCameraModel(std::string_view text, const std::string& source) {
  const PythonLiteral root = ParsePythonLiteral(text, source);
  if (root.kind != Kind::kDict) {
    throw CalibrationError(source + ", line " + std::to_string(root.line) +
                           ": expected a dictionary, found " + KindName(root.kind));
  }
  // Extrinsics are kept as they are: a rotation vector and a translation, camera from reference.
  const Reader reader(root, source);
  CameraModelFile file{reader.ReadCamera(), {}, reader.ValidRegion()};
  const std::vector<double> extrinsics = reader.Numbers("extrinsics", reader.Get("extrinsics"), 6);
  std::copy(extrinsics.begin(), extrinsics.end(), file.extrinsics.begin());
  return file;
}

std::string FormatCameraModel(const CameraModelFile& file) {
  const Camera& camera = file.camera;
  std::string name;
  std::vector<double> params = camera.params();
  for (const ModelName& model : kModels) {
    if (camera.model() == model.gsut) name = model.mrcal;
  }
  // Parameters that mrcal keeps in the name go back there.
  for (const ConfiguredName& model : ConfiguredModels()) {
    if (camera.model() != model.gsut) continue;
    name = model.mrcal;
    const auto count = static_cast<std::ptrdiff_t>(model.keys.size());
    const auto config = model.is_first ? params.begin() : params.end() - count;
    for (std::size_t i = 0; i < model.keys.size(); ++i) {
      name.append("_").append(model.keys[i]).append("=");
      name.append(Text(config[static_cast<std::ptrdiff_t>(i)]));
    }
    params.erase(config, config + count);
  }
  if (name.empty()) {
    throw InputError("a .cameramodel file cannot hold the lens '" + camera.model() +
                     "'; it holds " + KnownModels());
  }
  // Back to mrcal's pixel origin; the text has mrcal's own layout, comments included.
  params[2] -= kPixelShift;
  params[3] -= kPixelShift;
  std::ostringstream out;
  out << "{\n    'lensmodel':  '" << name << "',\n\n"
      << "    # intrinsics are fx,fy,cx,cy,distortion0,distortion1,....\n"
      << "    'intrinsics': " << ListText(params) << ",\n\n";
  if (file.valid_region.has_value()) {
    out << "    'valid_intrinsics_region': [\n";
    for (const auto& pixel : *file.valid_region) {
      out << "    [ " << Text(pixel[0] - kPixelShift) << ", " << Text(pixel[1] - kPixelShift)
          << " ],\n";
    }
    out << "    ],\n\n";
  }
  if (std::isfinite(camera.valid_field_angle())) {
    out << "    # radians from the axis; read by gsut only\n"
        << "    '" << kFieldAngleKey << "': " << Text(camera.valid_field_angle()) << ",\n\n";
  }
  out << "    # extrinsics are rt_cam_ref\n"
      << "    'extrinsics': " << ListText(file.extrinsics) << ",\n\n"
      << "    'imagersize': [ " << camera.width() << ", " << camera.height() << " ],\n}\n";
  return out.str();
}

}  // namespace gsut
