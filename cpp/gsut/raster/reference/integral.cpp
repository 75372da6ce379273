// Adaptive Gauss-Kronrod quadrature of the weights of overlapping Gaussians along one ray.
#include "gsut/raster/reference/integral.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace gsut {
namespace {

// An optical depth that no pixel shows in double.
constexpr double kLeastDepth = 1e-14;
// Light that is left where the integral may end: nothing behind it shows in double.
constexpr double kLeastLight = 1e-18;
// Standard deviations beyond which a density is 0 to rounding.
constexpr double kReach = 8.5;
// Difference of the two rules of a piece, summed over its Gaussians, at which it is not halved. The
// better rule's own error is its power 1.5, times some hundreds (Piessens et al., QUADPACK, 1983).
constexpr double kAgreement = 1e-11;
// Halvings of a piece, after which its ends are equal in double.
constexpr int kMostHalvings = 50;
// Where pieces end, in standard deviations from each mean.
constexpr double kBreaks[] = {-kReach, -4.0, -2.0, -1.0, 0.0, 1.0, 2.0, 4.0, kReach};

// Nodes and weights of Kronrod's rule of 15 points on [-1, 1]; every second node, from the second,
// is one of Gauss's rule of 7 (QUADPACK's qk15).
constexpr int kHalf = 7;
constexpr double kNodes[kHalf + 1] = {
    0.991455371120812639206854697526329, 0.949107912342758524526189684047851,
    0.864864423359769072789712788640926, 0.741531185599394439863864773280788,
    0.586087235467691130294144691693013, 0.405845151377397166906606412076961,
    0.207784955007898467600689403773245, 0.0};
constexpr double kKronrod[kHalf + 1] = {
    0.022935322010529224963732008058970, 0.063092092629978553290700663189204,
    0.104790010322250183839876322541518, 0.140653259715525918745189590510238,
    0.169004726639267902826583426598550, 0.190350578064785409913256402421014,
    0.204432940075298892414161999234649, 0.209482141084727828012999174891714};
constexpr double kGauss[4] = {
    0.129484966168869693270611432679082, 0.279705391489276667901467771423780,
    0.381830050505118944950369775488975, 0.417959183673469387755102040816327};

// A Gaussian's density along the ray.
struct Lobe {
  std::size_t hit;
  double depth, center, width;  // A, t, s
  double before;                // P(-t / s): the share that lies behind the origin
  double begin, end;            // beyond these it is 0

  double CdfAt(double t) const { return NormalCdf((t - center) / width); }
  double DensityAt(double t) const { return depth / width * NormalDensity((t - center) / width); }
};

// The integrals over one piece of the ray, a Gaussian that is not 0 there a place.
class Piece {
 public:
  // passed: the optical depth of what ends before the piece.
  Piece(const std::vector<Lobe>& lobes, const std::vector<std::size_t>& active, double passed)
      : lobes_(lobes), active_(active), passed_(passed) {}

  // Adds weight and weight x t of each active Gaussian to sums[2 hit] and sums[2 hit + 1].
  void Add(double begin, double end, int halvings, std::vector<double>* sums) const {
    const double middle = 0.5 * (begin + end), half = 0.5 * (end - begin);
    std::vector<double> kronrod(2 * active_.size(), 0.0), gauss(active_.size(), 0.0);
    for (int node = -kHalf; node <= kHalf; ++node) {
      const int k = kHalf - std::abs(node);
      const double t = middle + (node < 0 ? -half : half) * kNodes[k];
      const double light = LightAt(t);
      for (std::size_t i = 0; i < active_.size(); ++i) {
        const double value = half * light * lobes_[active_[i]].DensityAt(t);
        kronrod[2 * i] += kKronrod[k] * value;
        kronrod[2 * i + 1] += kKronrod[k] * value * t;
        if (k % 2 == 1) gauss[i] += kGauss[k / 2] * value;
      }
    }
    double apart = 0.0;
    for (std::size_t i = 0; i < active_.size(); ++i) apart += std::abs(kronrod[2 * i] - gauss[i]);
    if (apart > kAgreement && halvings < kMostHalvings) {
      Add(begin, middle, halvings + 1, sums);
      Add(middle, end, halvings + 1, sums);
      return;
    }
    for (std::size_t i = 0; i < active_.size(); ++i) {
      const std::size_t hit = lobes_[active_[i]].hit;
      (*sums)[2 * hit] += kronrod[2 * i];
      (*sums)[2 * hit + 1] += kronrod[2 * i + 1];
    }
  }

  double LightAt(double t) const {
    double depth = passed_;
    for (const std::size_t i : active_) {
      depth += lobes_[i].depth * (lobes_[i].CdfAt(t) - lobes_[i].before);
    }
    return std::exp(-depth);
  }

 private:
  const std::vector<Lobe>& lobes_;
  const std::vector<std::size_t>& active_;
  double passed_;
};

// The Gaussians that the ray meets, in the order of their begins, and a hit of each, by t.
std::vector<Lobe> FindLobes(const std::vector<Seen>& seen, const Ray& ray, const BlendRule& rule,
                            Response response, std::vector<Hit>* hits) {
  std::vector<Lobe> lobes;
  for (std::size_t j = 0; j < seen.size(); ++j) {
    const Passing at(seen[j], ray);
    const double along = ResponseOfLine(seen[j], ray, at, response);
    const double alpha = AlphaOf(response, seen[j].strength * along);
    const bool clamped = alpha > rule.alpha_max;
    const double depth = -std::log1p(-std::min(alpha, rule.alpha_max));
    const double width = at.Width();
    const double before = NormalCdf(-at.t / width);
    if (!(depth * (1.0 - before) > kLeastDepth)) continue;
    hits->push_back({j, std::min(alpha, rule.alpha_max), along, 0.0, at.t, clamped});
    lobes.push_back({0, depth, at.t, width, before, std::max(at.t - kReach * width, 0.0),
                     at.t + kReach * width});
  }
  std::stable_sort(hits->begin(), hits->end(),
                   [](const Hit& a, const Hit& b) { return a.t < b.t; });
  const auto by_center = [](const Lobe& a, const Lobe& b) { return a.center < b.center; };
  std::stable_sort(lobes.begin(), lobes.end(), by_center);
  for (std::size_t i = 0; i < lobes.size(); ++i) lobes[i].hit = i;
  std::stable_sort(lobes.begin(), lobes.end(),
                   [](const Lobe& a, const Lobe& b) { return a.begin < b.begin; });
  return lobes;
}

}  // namespace

double Integrate(const std::vector<Seen>& seen, const Ray& ray, const BlendRule& rule,
                 Response response, std::vector<Hit>* hits) {
  const std::vector<Lobe> lobes = FindLobes(seen, ray, rule, response, hits);
  std::vector<double> ends = {0.0};
  double whole = 0.0;
  for (const Lobe& lobe : lobes) {
    whole += lobe.depth * (1.0 - lobe.before);
    for (const double at : kBreaks) ends.push_back(std::max(lobe.center + at * lobe.width, 0.0));
  }
  std::sort(ends.begin(), ends.end());
  ends.erase(std::unique(ends.begin(), ends.end()), ends.end());
  // From piece to piece: what begins joins `active`, what has ended has taken all that it takes.
  std::vector<double> sums(2 * hits->size(), 0.0);
  std::vector<std::size_t> active;
  std::size_t next = 0;
  double passed = 0.0;
  for (std::size_t k = 0; k + 1 < ends.size(); ++k) {
    std::erase_if(active, [&](std::size_t i) {
      if (lobes[i].end > ends[k]) return false;
      passed += lobes[i].depth * (1.0 - lobes[i].before);
      return true;
    });
    while (next < lobes.size() && lobes[next].begin < ends[k + 1]) active.push_back(next++);
    if (active.empty()) continue;
    const Piece piece(lobes, active, passed);
    if (piece.LightAt(ends[k]) < kLeastLight) break;
    piece.Add(ends[k], ends[k + 1], 0, &sums);
  }
  for (std::size_t i = 0; i < hits->size(); ++i) {
    Hit& hit = (*hits)[i];
    hit.weight = sums[2 * i];
    if (hit.weight > 0.0) hit.t = sums[2 * i + 1] / hit.weight;
  }
  return std::exp(-whole);
}

}  // namespace gsut
