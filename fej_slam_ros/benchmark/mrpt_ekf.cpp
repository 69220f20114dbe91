// SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
// SPDX-License-Identifier: Apache-2.0
/*
 * Range-bearing EKF SLAM of MRPT for one robot, driven step by step through stdin and stdout:
 * mrpt_ekf {kfEKFNaive|kfEKFAlaDavison} RANGE_STD[m] BEARING_STD[rad]
 *
 * All numbers are little-endian 64-bit integers or doubles; matrices are row by row. stdin starts
 * with the start pose (Gaussian), followed by the steps: the motion in the robot frame (Gaussian),
 * the number of observations, and each Observation. A Reply follows each step.
 */

#include <mrpt/obs/CActionCollection.h>
#include <mrpt/obs/CActionRobotMovement2D.h>
#include <mrpt/obs/CObservationBearingRange.h>
#include <mrpt/obs/CSensoryFrame.h>
#include <mrpt/poses/CPosePDFGaussian.h>
#include <mrpt/slam/CRangeBearingKFSLAM2D.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <stdexcept>
#include <string>
#include <vector>

using namespace mrpt::obs;
using mrpt::poses::CPosePDFGaussian;

struct Gaussian  // of a pose x [m], y [m], phi [rad]
{
    double mean[3];
    double covariance[9];
};

struct Observation
{
    std::int64_t id;  // 0 to 2^31 - 1; MRPT would associate a negative ID by distance
    double range;     // [m]
    double bearing;   // [rad]
};

struct Reply
{
    std::int64_t nanoseconds;  // of the step, without the construction of its input
    Gaussian pose;
    std::uint64_t landmarks;  // in the map
};

// Reads some objects; returns false at the end of the input.
template <typename T> bool read(T* objects, std::size_t count = 1)
{
    return std::fread(objects, sizeof(T), count, stdin) == count;
}

CPosePDFGaussian to_mrpt(const Gaussian& pose)
{
    const auto& [x, y, phi] = pose.mean;
    return {{x, y, phi}, mrpt::math::CMatrixDouble33(pose.covariance)};
}

Gaussian from_mrpt(const CPosePDFGaussian& pose)
{
    Gaussian result{{pose.mean.x(), pose.mean.y(), pose.mean.phi()}, {}};
    for (int i = 0; i < 9; ++i) result.covariance[i] = pose.cov(i / 3, i % 3);
    return result;
}

CActionCollection::Ptr to_actions(const CPosePDFGaussian& motion)
{
    auto movement = CActionRobotMovement2D::Create();
    movement->poseChange = CPosePDFGaussian::Create(motion);
    auto actions = CActionCollection::Create();
    actions->insertPtr(movement);
    return actions;
}

CSensoryFrame::Ptr to_frame(const std::vector<Observation>& observations)
{
    auto scan = CObservationBearingRange::Create();
    // MRPT predicts the landmarks in the field of view, by default about 1.5 m ahead, and repeats
    // this if others were observed. The smallest field of view that avoids this is the fastest.
    scan->fieldOfView_yaw = static_cast<float>(2.0 * M_PI);
    for (const auto& [id, range, bearing] : observations)
    {
        CObservationBearingRange::TMeasurement measurement{};  // The pitch has to be 0.
        measurement.range = static_cast<float>(range);
        measurement.yaw = static_cast<float>(bearing);
        measurement.landmarkID = static_cast<std::int32_t>(id);
        scan->sensedData.push_back(measurement);
        scan->maxSensorDistance = std::max(scan->maxSensorDistance, measurement.range);
    }
    auto frame = CSensoryFrame::Create();
    frame->insert(scan);
    return frame;
}

void run(const std::string& method, float range_std, float bearing_std)
{
    mrpt::slam::CRangeBearingKFSLAM2D ekf;
    if (method == "kfEKFNaive") ekf.KF_options.method = mrpt::bayes::kfEKFNaive;
    else if (method == "kfEKFAlaDavison") ekf.KF_options.method = mrpt::bayes::kfEKFAlaDavison;
    else throw std::invalid_argument("unknown method " + method);
    ekf.options.std_sensor_range = range_std;
    ekf.options.std_sensor_yaw = bearing_std;

    // Messages of MRPT on stdout must not mix with the replies.
    std::FILE* replies = fdopen(dup(STDOUT_FILENO), "wb");
    if (replies == nullptr || dup2(STDERR_FILENO, STDOUT_FILENO) < 0)
        throw std::runtime_error("cannot redirect stdout");

    Gaussian start, motion;
    if (!read(&start)) throw std::invalid_argument("no start pose");
    CPosePDFGaussian pose = to_mrpt(start);
    for (std::int64_t count; read(&motion) && read(&count);)
    {
        std::vector<Observation> observations(count);
        if (!read(observations.data(), observations.size())) throw std::invalid_argument("cut step");
        auto actions = to_actions(to_mrpt(motion));
        auto frame = to_frame(observations);
        if (ekf.isMapEmpty())
        {
            // MRPT starts at the origin without covariance, and ignores motions without landmarks.
            pose += to_mrpt(motion);
            for (int i = 0; i < 3; ++i) ekf.internal_getXkk()[i] = pose.mean[i];
            ekf.internal_getPkk() = pose.cov;
        }
        const auto begin = std::chrono::steady_clock::now();
        ekf.processActionObservation(actions, frame);
        ekf.getCurrentRobotPose(pose);
        const std::chrono::nanoseconds elapsed = std::chrono::steady_clock::now() - begin;
        const Reply reply{elapsed.count(), from_mrpt(pose), ekf.getNumberOfLandmarksInTheMap()};
        if (std::fwrite(&reply, sizeof(reply), 1, replies) != 1 || std::fflush(replies) != 0)
            throw std::runtime_error("cannot write");
    }
}

int main(int argc, char** argv)
try
{
    if (argc != 4) throw std::invalid_argument("expected METHOD RANGE_STD BEARING_STD");
    run(argv[1], std::stof(argv[2]), std::stof(argv[3]));
}
catch (const std::exception& error)
{
    std::fprintf(stderr, "mrpt_ekf: %s\n", error.what());
    return 1;
}
