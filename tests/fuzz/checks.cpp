#include "checks.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>

extern "C" {
#include "host_file.h"
}

// Line numbers without LLVM's symbolizer: addr2line is there where a compiler is.
extern "C" const char *__asan_default_options()
{
    return "allow_addr2line=1:detect_leaks=0";
}

extern "C" const char *__ubsan_default_options()
{
    return "print_stacktrace=1";
}

namespace fuzz {
namespace {

// of the sum of |w_i dx_i|
constexpr double kRounding = 1e-6;
constexpr double kUnderflow = 1e-30; // products this small are rounded to nothing in float

template <class Test>
bool all(const float *values, int n, Test test)
{
    return std::all_of(values, values + n, test);
}

bool is_finite(float v)
{
    return std::isfinite(v);
}

bool is_nan(float v)
{
    return std::isnan(v);
}

bool is_share(float v)
{
    return v >= 0.0F && v <= 1.0F;
}

template <class Test>
bool response_is(const aminn_output_t &out, Test test)
{
    return all(out.dx_ht, AMINN_N_WRENCH, test) && all(&out.k_x[0][0], AMINN_N_WRENCH * AMINN_N_WRENCH, test) &&
           all(out.gate, AMINN_N_BRANCH, test);
}

// w.dx as a share of the sum of |w_i dx_i|
double work_share(const float *w_e, const float *dx)
{
    double work = 0.0;
    double size = 0.0;
    for (int i = 0; i < AMINN_N_WRENCH; ++i) {
        const double part = static_cast<double>(w_e[i]) * static_cast<double>(dx[i]);
        work += part;
        size += std::fabs(part);
    }
    return size > kUnderflow ? work / size : 1.0;
}

// returns its work_share
double check_stage(const aminn_stage_debug_t &stage, const float *w_e)
{
    FUZZ_CHECK(all(stage.dx, AMINN_N_WRENCH, is_finite));
    FUZZ_CHECK(all(stage.gate, AMINN_N_BRANCH, is_share));
    for (int i = 0; i < AMINN_N_WRENCH; ++i) {
        FUZZ_CHECK(stage.k_x[i][i] >= 0.0F && all(stage.k_x[i], AMINN_N_WRENCH, is_finite));
        for (int j = 0; j < i; ++j) {
            FUZZ_CHECK(stage.k_x[i][j] == stage.k_x[j][i]);
        }
    }
    const double share = work_share(w_e, stage.dx);
    FUZZ_CHECK(share >= -kRounding);
    return share;
}

// stage 2's results are the outputs
bool same_response(const aminn_stage_debug_t &stage, const aminn_output_t &out)
{
    return std::memcmp(stage.dx, out.dx_ht, sizeof out.dx_ht) == 0 &&
           std::memcmp(stage.k_x, out.k_x, sizeof out.k_x) == 0 &&
           std::memcmp(stage.gate, out.gate, sizeof out.gate) == 0;
}

void check_failed(const aminn_t &ctx, aminn_status_t status, const aminn_output_t &out)
{
    FUZZ_CHECK((status <= AMINN_E_NONFINITE && status >= AMINN_E_NUMERIC) || status == AMINN_E_SENSORS);
    FUZZ_CHECK(out.p_stable == 0.0F && out.stable == 0);
    FUZZ_CHECK(response_is(out, is_nan));
    FUZZ_CHECK(aminn_debug(&ctx, 0) == nullptr && aminn_debug(&ctx, 1) == nullptr);
}

} // namespace

void failed(const char *condition, const char *file, int line)
{
    std::fprintf(stderr, "%s:%d: does not hold: %s\n", file, line, condition);
    std::abort();
}

const aminn_input_t &golden_input()
{
    static const vector_header_t *header = open_vectors(GOLDEN_DIR "/golden.bin");
    return *reinterpret_cast<const aminn_input_t *>(header + 1);
}

void scribble(void *memory, size_t size)
{
    std::memset(memory, 0xA5, size);
}

double check_prediction(const aminn_t &ctx, const aminn_model_t &model, const float *w_e, aminn_status_t status,
                        const aminn_output_t &out)
{
    if (status != AMINN_OK) {
        check_failed(ctx, status, out);
        return 1.0;
    }
    FUZZ_CHECK(is_share(out.p_stable));
    FUZZ_CHECK(out.stable == (out.p_stable >= model.tau ? 1 : 0));
    const aminn_stage_debug_t *first = aminn_debug(&ctx, 0);
    const aminn_stage_debug_t *second = aminn_debug(&ctx, 1);
    const bool both = out.stable == 1 || (ctx.flags & AMINN_FLAG_ALWAYS_STAGE2) != 0;
    FUZZ_CHECK(first != nullptr && (second != nullptr) == both);
    FUZZ_CHECK(both ? same_response(*second, out) : response_is(out, is_nan));
    FUZZ_CHECK(both ? is_share(out.p_slide) && is_finite(out.bound_95) && out.bound_95 >= 0.0F
                    : is_nan(out.p_slide) && is_nan(out.bound_95));
    FUZZ_CHECK(all(out.friction_use, AMINN_N_BRANCH, [](float use) { return use >= 0.0F && use <= 100.0F; }));
    const double share = check_stage(*first, w_e);
    return both ? std::min(share, check_stage(*second, w_e)) : share;
}

} // namespace fuzz
