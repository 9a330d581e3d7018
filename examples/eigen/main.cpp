// C++ with Eigen: the same grasp under its load turned about the hand's z axis, one direction after the other. Views lie on the
// structs of the C interface, so nothing is copied.
#include <aminn_rt.hpp>

#include <cstdio>

#include <Eigen/Geometry>

#include "aminn_model.h"

int main()
{
    static aminn_t ctx;
    static aminn_output_t out;
    aminn_state_t state = aminn_model.known_answer->state; // yours: from encoders and sensors
    const Eigen::Vector3f load = aminn::view::force(state);
    aminn_status_t status = aminn_init(&ctx, &aminn_model, 0);
    constexpr int kDirections = 8;
    for (int k = 0; k < kDirections && status == AMINN_OK; ++k) {
        const float angle = 6.2831853F * static_cast<float>(k) / kDirections;
        aminn::view::force(state) = Eigen::AngleAxisf(angle, Eigen::Vector3f::UnitZ()) * load;
        status = aminn_predict_state(&ctx, &state, &out);
        const float work = aminn::view::force(state).dot(aminn::view::translation(out)) +
                           aminn::view::moment(state).dot(aminn::view::rotation(out));
        std::printf("%3.0f degrees: p_stable %.2f", static_cast<double>(angle) * 57.29578,
                    static_cast<double>(out.p_stable));
        if (status == AMINN_OK && out.stable != 0) { // else there is no motion
            std::printf(", moves by %.3f mm, work %.2e J",
                        1e3 * static_cast<double>(aminn::view::translation(out).norm()), static_cast<double>(work));
        }
        std::printf("\n");
    }
    if (status != AMINN_OK) {
        std::fprintf(stderr, "%s\n", aminn_status_text(status));
    }
    return status == AMINN_OK ? 0 : 1;
}
