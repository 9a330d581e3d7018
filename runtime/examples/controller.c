/*
 * A controller's start and one of its ticks, for the reference hand: readings of the drivers in their own units, a state in
 * those of aminn_rt.h, a prediction, and what to look at before it is believed. Put your own drivers where "readings" stand:
 * these are of one simulated grasp, a cylinder of 31 mm between both fingertips and the thumb's.
 *
 * Ends with 0 if the grasp holds, 1 if not or if that cannot be said.
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "aminn_model.h"

static aminn_t ctx;
static aminn_state_t state;
static aminn_output_t out;

/* ---- readings: replace these by your drivers ---- */

/* Encoders of 14 bits. What each shows with straight fingers comes from your calibration; so does the sign, which is such
 * that bending a finger, and rolling it away from the other one, counts up. */
enum { COUNTS_PER_TURN = 16384 };
static const int encoder_zero[AMINN_N_JOINT] = {8170, 8211, 8190, 8205, 8192, 8188, 8199, 8184};
static const int encoder_sign[AMINN_N_JOINT] = {1, 1, 1, 1, 1, 1, 1, 1};

static void read_encoders(int counts[AMINN_N_JOINT])
{
    static const int readings[AMINN_N_JOINT] = {8479, 8665, 9462, 8540, 8533, 9608, 8432, 9742};
    memcpy(counts, readings, sizeof readings);
}

/* The tool's centre of mass in the palm's frame, mm, and its orientation as a unit quaternion (w, x, y, z). */
static void read_tool_pose(double position_mm[3], double quaternion[4])
{
    static const double p[3] = {-11.5, -0.8, 90.3}, q[4] = {0.99803, 0.0128, 0.0590, -0.0173};
    memcpy(position_mm, p, sizeof p);
    memcpy(quaternion, q, sizeof q);
}

/* A fingertip's sensor: where it touches the tool (mm) and the direction into the tool, both in the palm's frame, and how
 * hard it presses along that direction (N). Returns 0 where nothing is touched. */
static int read_contact(int branch, double point_mm[3], double normal[3], double *force)
{
    static const struct {
        double point_mm[3], normal[3], force;
    } readings[AMINN_N_BRANCH] = {{{25.9, 13.2, 88.2}, {-0.05, -0.99, -0.15}, 2.6},
                                  {{-26.7, 15.1, 90.6}, {-0.02, -0.99, 0.10}, 3.2},
                                  {{0.3, -16.7, 89.3}, {0.03, 1.00, -0.03}, 6.1}};
    memcpy(point_mm, readings[branch].point_mm, sizeof readings[branch].point_mm);
    memcpy(normal, readings[branch].normal, sizeof readings[branch].normal);
    *force = readings[branch].force;
    return 1;
}

/* ---- from the readings to a state ---- */

static void fill_joints(void)
{
    int counts[AMINN_N_JOINT], j;
    read_encoders(counts);
    for (j = 0; j < AMINN_N_JOINT; ++j) {
        const int turned = encoder_sign[j] * (counts[j] - encoder_zero[j]);
        state.q[j] = (float)(turned * 2.0 * 3.14159265358979323846 / (double)COUNTS_PER_TURN);
    }
}

/* A rotation vector is the axis times the angle: nearly twice the quaternion's vector part, not that part itself. */
static void fill_tool_pose(void)
{
    double p[3], q[4], length, sign, scale;
    int i;
    read_tool_pose(p, q);
    length = sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    sign = q[0] < 0 ? -1 : 1; /* q and -q are the same rotation: the one below pi */
    scale = length > 1e-9 ? 2 * atan2(length, sign * q[0]) / length : 2;
    for (i = 0; i < 3; ++i) {
        state.x_ht[i] = (float)(1e-3 * p[i]);
        state.x_ht[3 + i] = (float)(sign * scale * q[1 + i]);
    }
}

static void fill_contacts(void)
{
    int b, i;
    for (b = 0; b < AMINN_N_BRANCH; ++b) {
        float *row = state.contacts[b];
        double point[3], normal[3], force, length;
        memset(row, 0, sizeof state.contacts[b]);
        if (!read_contact(b, point, normal, &force)) {
            continue;
        }
        length = sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]);
        row[0] = 1.0F;
        for (i = 0; i < 3; ++i) {
            row[1 + i] = (float)(1e-3 * point[i]);
            row[4 + i] = (float)(normal[i] / length); /* sensors round: a unit vector is asked for */
        }
        row[7] = (float)force;
    }
}

/* The load to come, from the task: force (N) on the tool at a point (mm, palm frame). Its moment is about the tool's origin. */
static void fill_load(const double force[3], const double point_mm[3])
{
    double arm[3];
    int i;
    for (i = 0; i < 3; ++i) {
        arm[i] = 1e-3 * point_mm[i] - (double)state.x_ht[i];
        state.w_e[i] = (float)force[i];
    }
    for (i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        state.w_e[3 + i] = (float)(arm[j] * force[k] - arm[k] * force[j]);
    }
}

/* ---- start and tick ---- */

static aminn_status_t controller_start(void)
{
    aminn_status_t status = aminn_init(&ctx, &aminn_model, 0);
    return status != AMINN_OK ? status : aminn_self_test(&ctx);
}

/* 1: the grasp holds and the tool will move by out.dx_ht; 0: it will not hold, or the model does not know such states;
 * negative: status code */
static int controller_step(void)
{
    aminn_status_t status = aminn_predict_state(&ctx, &state, &out);
    return status != AMINN_OK ? (int)status : out.stable && out.notes == 0;
}

static void explain_notes(void)
{
    const int field = aminn_first_out_of_range(&aminn_model, &state);
    if (field >= 0) {
        printf("%s lies outside %g .. %g, where the model was trained\n", aminn_field_name(field),
               (double)aminn_model.range_min[field], (double)aminn_model.range_max[field]);
    }
    if ((out.notes & AMINN_NOTE_ILL_CONDITIONED) != 0) {
        printf("the grasp is so soft in a direction that dx_ht may have few correct digits\n");
    }
}

int main(void)
{
    static const double force[3] = {-0.2, -0.4, -1.1}, point_mm[3] = {-11.5, -0.8, 90.3};
    int result = (int)controller_start();
    printf("aminn_rt %s, model %s of %s\n", aminn_version(), aminn_model.name, aminn_model.hand);
    if (result == AMINN_OK) {
        fill_joints();
        fill_tool_pose();
        fill_contacts();
        fill_load(force, point_mm);
        result = controller_step();
    }
    if (result < 0) {
        fprintf(stderr, "%s: %s\n", aminn_status_name(result), aminn_status_text(result));
        return 1;
    }
    printf("p_stable %.2f: %s; notes %u\n", (double)out.p_stable, out.stable ? "holds" : "does not hold",
           (unsigned)out.notes);
    explain_notes();
    if (out.stable) {
        printf("the tool moves by %.2f %.2f %.2f mm and turns by %.2f %.2f %.2f degrees\n", 1e3 * (double)out.dx_ht[0],
               1e3 * (double)out.dx_ht[1], 1e3 * (double)out.dx_ht[2], 57.29578 * (double)out.dx_ht[3],
               57.29578 * (double)out.dx_ht[4], 57.29578 * (double)out.dx_ht[5]);
    }
    return result == 1 ? 0 : 1;
}
