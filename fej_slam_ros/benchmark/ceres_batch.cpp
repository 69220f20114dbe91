// SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
// SPDX-License-Identifier: Apache-2.0

// Batch least squares by Ceres, for ceres.py: a problem from standard input, in its order there,
// and the solution to standard output. The residuals are those of least_squares.py.

#include <ceres/ceres.h>

#include <chrono>
#include <cmath>
#include <cstdint>
#include <iostream>
#include <vector>

namespace {

template <typename T>
T read_one()
{
    T value;
    std::cin.read(reinterpret_cast<char *>(&value), sizeof value);
    return value;
}

std::vector<double> read_doubles(size_t count)
{
    std::vector<double> values(count);
    std::cin.read(reinterpret_cast<char *>(values.data()), count * sizeof(double));
    return values;
}

template <typename T>
void to_frame_of(const T *pose, const T *point, T *z)
{
    T c = cos(pose[2]), s = sin(pose[2]), dx = point[0] - pose[0], dy = point[1] - pose[1];
    z[0] = c * dx + s * dy;
    z[1] = c * dy - s * dx;
}

// r = whitener (z - h) with a measurement z of d numbers.
template <int d>
struct Measurement
{
    double z[d], whitener[d * d];

    template <typename T>
    void whiten(const T *h, T *r) const
    {
        for (int i = 0; i < d; i++) {
            r[i] = T(0.0);
            for (int j = 0; j < d; j++)
                r[i] += whitener[i * d + j] * (z[j] - h[j]);
        }
    }
};

struct Increment : Measurement<3>
{
    template <typename T>
    bool operator()(const T *begin, const T *end, T *r) const
    {
        T h[3];
        to_frame_of(begin, end, h);
        T e = z[2] - (end[2] - begin[2]);
        h[2] = z[2] - (e - 2.0 * M_PI * floor((e + M_PI) / (2.0 * M_PI)));
        whiten(h, r);
        return true;
    }
};

struct Observation : Measurement<2>
{
    template <typename T>
    bool operator()(const T *pose, const T *point, T *r) const
    {
        T h[2];
        to_frame_of(pose, point, h);
        whiten(h, r);
        return true;
    }
};

template <typename Residual, int d, int target_size>
void add_all(
    ceres::Problem &problem, std::vector<double> &poses, std::vector<double> &targets,
    int64_t count)
{
    for (int64_t k = 0; k < count; k++) {
        auto pose = read_one<int64_t>(), target = read_one<int64_t>();
        auto *residual = new Residual;
        std::cin.read(reinterpret_cast<char *>(residual), sizeof *residual);
        problem.AddResidualBlock(
            new ceres::AutoDiffCostFunction<Residual, d, 3, target_size>(residual), nullptr,
            &poses[3 * pose], &targets[target_size * target]);
    }
}

void write(const void *data, size_t size)
{
    std::cout.write(static_cast<const char *>(data), size);
}

}  // namespace

int main()
{
    auto tolerance = read_one<double>();
    auto iterations = read_one<int64_t>(), fixed = read_one<int64_t>();
    auto n = read_one<int64_t>(), l = read_one<int64_t>();
    auto increments = read_one<int64_t>(), observations = read_one<int64_t>();
    auto poses = read_doubles(3 * n), points = read_doubles(2 * l);

    ceres::Problem problem;
    add_all<Increment, 3, 3>(problem, poses, poses, increments);
    add_all<Observation, 2, 2>(problem, poses, points, observations);
    problem.SetParameterBlockConstant(&poses[3 * fixed]);

    ceres::Solver::Options options;
    options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
    options.function_tolerance = tolerance;
    options.max_num_iterations = static_cast<int>(iterations);
    options.num_threads = 1;
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    auto begin = std::chrono::steady_clock::now();
    ceres::Solve(options, &problem, &summary);
    std::chrono::duration<double> taken = std::chrono::steady_clock::now() - begin;

    double seconds = taken.count();
    int64_t steps = summary.num_successful_steps + summary.num_unsuccessful_steps;
    write(&seconds, sizeof seconds);
    write(&steps, sizeof steps);
    write(poses.data(), poses.size() * sizeof(double));
    write(points.data(), points.size() * sizeof(double));
}
