// Tracks by union-find that refuses two features of one image.
#include "gsut/sfm/tracks.h"

#include <algorithm>
#include <numeric>
#include <string>

#include "gsut/base/errors.h"

namespace gsut {
namespace {

// Matches are edges between features of images, and a track is a component that sees each image at
// most once. One wrong match would tie two points into one, so an edge that would give an image two
// features is refused; edges therefore come in order of trust, and their order matters.
class Components {
 public:
  Components(std::vector<TrackElement> elements) : parent_(elements.size()), members_() {
    std::iota(parent_.begin(), parent_.end(), 0);
    members_.resize(elements.size());
    for (std::size_t i = 0; i < elements.size(); ++i) members_[i] = {elements[i]};
  }

  // Path halving: each visit points nodes to their grandparents.
  int Root(int node) {
    while (parent_[node] != node) {
      parent_[node] = parent_[parent_[node]];
      node = parent_[node];
    }
    return node;
  }

  // Joins two components unless both have a feature of the same image.
  void Join(int a, int b) {
    a = Root(a);
    b = Root(b);
    if (a == b) return;
    // Members are sorted by image.
    if (members_[a].size() < members_[b].size()) std::swap(a, b);
    std::vector<TrackElement>& own = members_[a];
    const auto earlier = [](const TrackElement& x, const TrackElement& y) {
      return x.image < y.image;
    };
    for (const TrackElement& element : members_[b]) {
      if (std::binary_search(own.begin(), own.end(), element, earlier)) return;
    }
    const auto before = static_cast<std::ptrdiff_t>(own.size());
    own.insert(own.end(), members_[b].begin(), members_[b].end());
    std::inplace_merge(own.begin(), own.begin() + before, own.end(), earlier);
    members_[b] = {};
    parent_[b] = a;
  }

  std::vector<std::vector<TrackElement>> Tracks() && {
    std::vector<std::vector<TrackElement>> tracks;
    for (auto& members : members_) {
      if (members.size() >= 2) tracks.push_back(std::move(members));
    }
    return tracks;
  }

 private:
  std::vector<int> parent_;
  std::vector<std::vector<TrackElement>> members_;
};

}  // namespace

std::vector<std::vector<TrackElement>> JoinTracks(std::span<const int> num_features,
                                                  std::span<const TrackJoin> joins) {
  const int images = static_cast<int>(num_features.size());
  // Features are numbered across images, one node each.
  std::vector<int> begin(images + 1, 0);
  std::vector<TrackElement> elements;
  for (int image = 0; image < images; ++image) {
    begin[image + 1] = begin[image] + num_features[image];
    for (int feature = 0; feature < num_features[image]; ++feature) {
      elements.push_back({image, feature});
    }
  }
  for (const auto& [a, b] : joins) {
    const auto known = [&](int image) { return image >= 0 && image < images; };
    if (!known(a.image) || !known(b.image) || a.image == b.image) {
      throw InputError("a pair names images " + std::to_string(a.image) + " and " +
                       std::to_string(b.image) + " of " + std::to_string(images));
    }
    const auto there = [&](const TrackElement& e) {
      return e.feature >= 0 && e.feature < num_features[e.image];
    };
    if (!there(a) || !there(b)) {
      throw InputError("a match of images " + std::to_string(a.image) + " and " +
                       std::to_string(b.image) + " names a feature that is not there");
    }
  }
  Components components(std::move(elements));
  for (const auto& [a, b] : joins) {
    components.Join(begin[a.image] + a.feature, begin[b.image] + b.feature);
  }
  return std::move(components).Tracks();
}

std::vector<std::vector<TrackElement>> BuildTracks(std::span<const int> num_features,
                                                   std::span<const VerifiedPair> pairs) {
  std::vector<int> order(pairs.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(),
                   [&](int a, int b) { return pairs[a].matches.size() > pairs[b].matches.size(); });
  std::vector<TrackJoin> joins;
  for (const int index : order) {
    const VerifiedPair& pair = pairs[index];
    for (const auto& [a, b] : pair.matches) {
      joins.push_back({{pair.first, a}, {pair.second, b}});
    }
  }
  return JoinTracks(num_features, joins);
}

}  // namespace gsut
