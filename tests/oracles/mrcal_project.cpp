// Projects points with libmrcal, for make_lens_vectors.py. Not part of the build:
//   g++ -fpermissive -w mrcal_project.cpp -lmrcal -o mrcal_project
// Standard input, any number of times: model name, number of parameters, parameters, number of
// points, points. Standard output: one pixel a line.
extern "C" {
#include <mrcal/mrcal.h>
}
#include <iostream>
#include <string>
#include <vector>

int main() {
  std::cout.precision(17);
  std::string name;
  std::size_t num_params = 0, num_points = 0;
  while (std::cin >> name >> num_params) {
    std::vector<double> params(num_params);
    for (double& value : params) std::cin >> value;
    std::cin >> num_points;
    std::vector<mrcal_point3_t> points(num_points);
    for (mrcal_point3_t& p : points) std::cin >> p.x >> p.y >> p.z;
    mrcal_lensmodel_t model;
    if (!mrcal_lensmodel_from_name(&model, name.c_str()) ||
        mrcal_lensmodel_num_params(&model) != static_cast<int>(num_params)) {
      std::cerr << "libmrcal: no " << name << " with " << num_params << " parameters\n";
      return 1;
    }
    for (const mrcal_point3_t& p : points) {
      mrcal_point2_t pixel;
      if (!mrcal_project(&pixel, nullptr, nullptr, &p, 1, &model, params.data())) return 1;
      std::cout << pixel.x << " " << pixel.y << "\n";
    }
  }
}
