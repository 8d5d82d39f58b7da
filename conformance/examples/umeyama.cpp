// An evaluator in C++ with Eigen's umeyama(), scored by the kit:
//   g++ -O2 -I /usr/include/eigen3 umeyama.cpp -o umeyama
//   ./umeyama ../cases/*/ > umeyama.json && python ../score.py umeyama.json
// It has the absolute errors of cases whose rows pair by equal timestamps.
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>
#include <string>
#include <vector>
using namespace Eigen;
struct Pose { Vector3d p; Quaterniond q; };

std::map<std::string, Pose> read(const std::filesystem::path& file) {
    std::map<std::string, Pose> poses;  // by the text of the timestamp
    std::ifstream stream(file);
    for (std::string line; std::getline(stream, line);) {
        std::istringstream words(line);
        std::string stamp;
        Pose a;
        if (words >> stamp && stamp[0] != '#' &&
            words >> a.p[0] >> a.p[1] >> a.p[2] >> a.q.x() >> a.q.y() >> a.q.z() >> a.q.w()) {
            a.q.normalize();
            poses[stamp] = a;
        }
    }
    return poses;
}

void print(const std::string& name, std::vector<double> e, const char* separator) {
    std::sort(e.begin(), e.end());
    const size_t n = e.size();
    double squares = 0, sum = 0;
    for (double x : e) squares += x * x, sum += x;
    std::printf("\"%s.rmse\": %.17g, \"%s.mean\": %.17g, ", name.c_str(), std::sqrt(squares / n),
                name.c_str(), sum / n);
    std::printf("\"%s.median\": %.17g, \"%s.max\": %.17g%s", name.c_str(),
                (e[(n - 1) / 2] + e[n / 2]) / 2, name.c_str(), e[n - 1], separator);
}

int main(int count, char** folders) {
    std::printf("{\"tool\": \"Eigen umeyama\", \"version\": \"%d.%d.%d\", \"results\": {",
                EIGEN_WORLD_VERSION, EIGEN_MAJOR_VERSION, EIGEN_MINOR_VERSION);
    bool first = true;
    for (int i = 1; i < count; i++) {
        const auto folder = std::filesystem::path(folders[i]);
        const auto truth = read(folder / "groundtruth.txt"), other = read(folder / "estimate.txt");
        const int n = truth.size();
        if (n != int(other.size()) || !std::equal(truth.begin(), truth.end(), other.begin(),
                [](const auto& a, const auto& b) { return a.first == b.first; })) continue;
        Matrix3Xd p(3, n), q(3, n);
        int k = 0;
        for (const auto& [stamp, pose] : truth) p.col(k) = pose.p, q.col(k++) = other.at(stamp).p;
        auto name = folder.filename().empty() ? folder.parent_path().filename() : folder.filename();
        std::printf("%s\n\"%s\": {", first ? "" : ",", name.c_str());
        first = false;
        for (const std::string kind : {"none", "se3", "sim3"}) {
            const Matrix4d T = kind == "none" ? Matrix4d(Matrix4d::Identity())
                                              : Matrix4d(umeyama(q, p, kind == "sim3"));
            const double s = std::cbrt(T.topLeftCorner<3, 3>().determinant());
            const Quaterniond R(Matrix3d(T.topLeftCorner<3, 3>() / s));
            std::vector<double> position, rotation;
            for (const auto& [stamp, pose] : truth) {
                const Pose& e = other.at(stamp);
                position.push_back((pose.p - (T * e.p.homogeneous()).head<3>()).norm());
                rotation.push_back(pose.q.angularDistance(R * e.q) * 180 / M_PI);
            }
            print("position_m." + kind, position, ", ");
            print("rotation_deg." + kind, rotation, ", ");
            if (kind == "sim3") std::printf("\"scale.sim3\": %.17g}", s);
        }
    }
    std::printf("}}\n");
}
