// A camera without its pose: construction and everything that is not a loop over points.
#include "gsut/cameras/camera.h"

#include <algorithm>
#include <sstream>
#include <utility>

#include "gsut/base/errors.h"
#include "gsut/cameras/camera_state.h"
#include "gsut/cameras/visit_lens.h"

namespace gsut {
namespace {

// Most parameters of a lens without a table: several times the coefficients that any calibration
// gives. The search for a domain takes memory and time by the square of their number.
constexpr int kMostParams = 100;

void CheckSize(int width, int height) {
  if (width > 0 && height > 0) return;
  throw InputError("the image size must be positive, found " + std::to_string(width) + " x " +
                   std::to_string(height));
}

// Everything that can be wrong with a lens is found here, once: projections check nothing but the
// domain.
LensDomain CheckedDomain(LensModel lens, const std::vector<double>& params, int width, int height,
                         double angle) {
  if (!(angle > 0.0)) {
    std::ostringstream message;
    message << "valid_field_angle is " << angle << "; it must be positive (radians)";
    throw InputError(message.str());
  }
  return VisitLens(lens, [&](auto model) {
    using Lens = decltype(model);
    const int num_params = static_cast<int>(params.size());
    if (!Lens::AcceptsParams(num_params)) {
      throw InputError(std::string(Lens::kName) + " takes the parameters \"" + Lens::kParamNames +
                       "\", found " + std::to_string(num_params) + " values");
    }
    if (num_params > kMostParams && !requires { Lens::kHasTable; }) {
      throw InputError(std::string(Lens::kName) + " takes at most " + std::to_string(kMostParams) +
                       " parameters, found " + std::to_string(num_params));
    }
    // No direction is farther from the axis than pi.
    const double limit = std::min(angle, kPi);
    if constexpr (requires { Lens::kTakesSize; }) {
      return Lens::MakeDomain(params.data(), num_params, limit, width, height);
    } else {
      return Lens::MakeDomain(params.data(), num_params, limit);
    }
  });
}

}  // namespace

// The state is shared and never changes, so copies of a camera are cheap and its ray table is
// common.
Camera::Camera(std::string_view model, std::vector<double> params, int width, int height,
               double valid_field_angle) {
  const LensModel lens = LensFromName(model);
  CheckSize(width, height);
  const LensDomain domain = CheckedDomain(lens, params, width, height, valid_field_angle);
  auto state = std::make_shared<State>();
  state->lens = lens;
  state->params = std::move(params);
  state->width = width;
  state->height = height;
  state->valid_field_angle = valid_field_angle;
  state->domain = domain;
  state_ = std::move(state);
}

LensModel Camera::lens() const { return state_->lens; }
std::string Camera::model() const { return LensName(state_->lens); }
const std::vector<double>& Camera::params() const { return state_->params; }
int Camera::width() const { return state_->width; }
int Camera::height() const { return state_->height; }
double Camera::valid_field_angle() const { return state_->valid_field_angle; }
const LensDomain& Camera::domain() const { return state_->domain; }

// Members of contract.h that a lens declares or not; asked of the struct, never of its name.
bool Camera::IsCentral() const {
  return VisitLens(lens(), [](auto lens) {
    return !requires { decltype(lens)::kHasOrigins; };
  });
}

bool Camera::IsParallel() const {
  return VisitLens(lens(), [](auto lens) {
    return requires { decltype(lens)::kIsParallel; };
  });
}

// Scaling is about the image's corner: with pixel centres at halves, (0, 0) stays (0, 0).
Camera Camera::Resized(int width, int height) const {
  CheckSize(width, height);
  const double scale_x = static_cast<double>(width) / state_->width;
  const double scale_y = static_cast<double>(height) / state_->height;
  std::vector<double> params = state_->params;
  VisitLens(state_->lens, [&](auto lens) {
    using Lens = decltype(lens);
    // fx and cx scale with the width, fy and cy with the height; coefficients have no unit.
    if constexpr (requires { Lens::Rescale(params.data(), 0, 1.0, 1.0); }) {
      Lens::Rescale(params.data(), num_params(), scale_x, scale_y);
    } else {
      params[0] *= scale_x;
      params[1] *= scale_y;
      params[2] *= scale_x;
      params[3] *= scale_y;
    }
  });
  return Camera(model(), std::move(params), width, height, state_->valid_field_angle);
}

Camera Camera::WithValidFieldAngle(double valid_field_angle) const {
  return Camera(model(), state_->params, state_->width, state_->height, valid_field_angle);
}

// Equal values are equal cameras, wherever they came from; the domain follows from them.
bool operator==(const Camera& a, const Camera& b) {
  return a.state_ == b.state_ ||
         (a.lens() == b.lens() && a.params() == b.params() && a.width() == b.width() &&
          a.height() == b.height() && a.valid_field_angle() == b.valid_field_angle());
}

}  // namespace gsut
