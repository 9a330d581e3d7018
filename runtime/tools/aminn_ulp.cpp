/*
 * aminn_ulp - largest errors of the runtime's elementary functions beside the C library's in double precision.
 *
 *   aminn_ulp STRIDE
 *
 * Tries every STRIDE-th bit pattern of float (1: all of them) and prints, as one JSON object, the largest error of each
 * function in units of the last place of the exact result; of sine and cosine in units of 2^-24. Exits with 1 if one
 * exceeds the bound that src/elementary.hpp states, with 2 on bad arguments.
 */
#include <cfloat>
#include <cmath>
#include <cstdio>
#include <cstdlib>

#include "elementary.hpp"

namespace {

using namespace aminn;

struct Function {
    const char *name;
    float low, high;
    double bound;
    bool absolute; // in units of 2^-24
    float (*approximate)(float);
    double (*exact)(double);
};

const Function kFunctions[] = {
    {"exp", -86.0F, 88.72F, 1.1, false, [](float x) { return exponential(x); }, [](double x) { return std::exp(x); }},
    {"log", FLT_MIN, FLT_MAX, 1.0, false, [](float x) { return logarithm(x); }, [](double x) { return std::log(x); }},
    {"tanh", -FLT_MAX, FLT_MAX, 2.0, false, [](float x) { return hyperbolic_tangent(x); },
     [](double x) { return std::tanh(x); }},
    {"sigmoid", -86.0F, FLT_MAX, 3.0, false, [](float x) { return sigmoid(x); },
     [](double x) { return 1.0 / (1.0 + std::exp(-x)); }},
    {"sin", -kMaxAngle, kMaxAngle, 1.5, true, [](float x) { return sine_cosine(x).sine; },
     [](double x) { return std::sin(x); }},
    {"cos", -kMaxAngle, kMaxAngle, 1.5, true, [](float x) { return sine_cosine(x).cosine; },
     [](double x) { return std::cos(x); }},
};

double unit_in_last_place(double exact)
{
    int exponent = 0;
    std::frexp(std::fmax(std::fabs(exact), static_cast<double>(FLT_MIN)), &exponent);
    return std::ldexp(1.0, exponent - 24);
}

double largest_error(const Function &f, uint32_t stride)
{
    double worst = 0.0;
    for (uint64_t u = 0; u <= 0xFFFFFFFFu; u += stride) {
        const float x = from_bits(static_cast<uint32_t>(u));
        if (x >= f.low && x <= f.high) {
            const double exact = f.exact(static_cast<double>(x));
            const double unit = f.absolute ? std::ldexp(1.0, -24) : unit_in_last_place(exact);
            const double error = std::fabs(static_cast<double>(f.approximate(x)) - exact) / unit;
            worst = error <= worst ? worst : error; // NaN counts
        }
    }
    return worst;
}

} // namespace

int main(int argc, char **argv)
{
    const unsigned long stride = argc == 2 ? std::strtoul(argv[1], nullptr, 10) : 0;
    if (stride == 0 || stride > 0xFFFFFFFFu) {
        std::fprintf(stderr, "usage: %s STRIDE\n", argv[0]);
        return 2;
    }
    int wrong = 0;
    const char *separator = "{";
    for (const Function &f : kFunctions) {
        const double error = largest_error(f, static_cast<uint32_t>(stride));
        std::printf("%s\"%s_%s_max\": %.4f", separator, f.name, f.absolute ? "error_2_24" : "ulp", error);
        separator = ", ";
        if (!(error <= f.bound)) {
            std::fprintf(stderr, "%s: %s: %.4f exceeds %.1f\n", argv[0], f.name, error, f.bound);
            wrong = 1;
        }
    }
    std::printf("}\n");
    return wrong;
}
