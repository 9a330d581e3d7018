// The C runtime as the Python module aminn_export._runtime: what a model's known answer is computed with.
#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include "aminn_rt.h"

namespace nb = nanobind;

namespace {

constexpr size_t kOutputWords = sizeof(aminn_output_t) / sizeof(uint32_t);
constexpr size_t kStagesWords = AMINN_N_STAGE * sizeof(aminn_stage_debug_t) / sizeof(uint32_t);
constexpr size_t kInputWords = sizeof(aminn_input_t) / sizeof(float);

using Numbers = nb::ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
template <class T>
using Array = nb::ndarray<nb::numpy, T>;

template <class T>
Array<T> array(size_t rows, size_t columns)
{
    T *memory = new T[rows * columns]();
    return Array<T>(memory, {rows, columns},
                    nb::capsule(memory, [](void *p) noexcept { delete[] static_cast<T *>(p); }));
}

void require(aminn_status_t status, const char *what)
{
    if (status != AMINN_OK) {
        throw nb::value_error((std::string(what) + ": " + aminn_status_text(status)).c_str());
    }
}

// A copy where the runtime may use it in place.
std::vector<uint64_t> aligned(const nb::bytes &blob)
{
    std::vector<uint64_t> copy((blob.size() + sizeof(uint64_t) - 1) / sizeof(uint64_t));
    std::memcpy(copy.data(), blob.data(), blob.size());
    return copy;
}

// One row: a state, or a whole input.
aminn_status_t predict(aminn_t &ctx, const float *row, size_t columns, aminn_output_t &out)
{
    if (columns == AMINN_N_STATE) {
        aminn_state_t state;
        std::memcpy(&state, row, sizeof state);
        return aminn_predict_state(&ctx, &state, &out);
    }
    aminn_input_t in;
    std::memcpy(&in, row, sizeof in);
    return aminn_predict(&ctx, &in, &out);
}

nb::tuple run(const nb::bytes &blob, const Numbers &numbers)
{
    const size_t n = numbers.shape(0);
    const size_t columns = numbers.shape(1);
    if (columns != AMINN_N_STATE && columns != kInputWords) {
        throw nb::value_error(("numbers: expected " + std::to_string(AMINN_N_STATE) + " (a state) or " +
                               std::to_string(kInputWords) + " (an input) a row")
                                  .c_str());
    }
    const std::vector<uint64_t> bytes = aligned(blob);
    aminn_model_t model;
    require(aminn_model_from_blob(bytes.data(), blob.size(), &model), "model");
    std::vector<aminn_t> ctx(1);
    require(aminn_init(ctx.data(), &model, AMINN_FLAG_ALWAYS_STAGE2 | AMINN_FLAG_DEBUG), "model");
    Array<uint32_t> outputs = array<uint32_t>(n, kOutputWords);
    Array<uint32_t> stages = array<uint32_t>(n, kStagesWords);
    Array<int32_t> statuses = array<int32_t>(n, 1);
    for (size_t i = 0; i < n; ++i) {
        aminn_output_t out;
        statuses.data()[i] = predict(ctx[0], numbers.data() + i * columns, columns, out);
        std::memcpy(outputs.data() + i * kOutputWords, &out, sizeof out);
        const aminn_stage_debug_t *first = aminn_debug(ctx.data(), 0); // the second lies behind it
        if (first != nullptr) {
            std::memcpy(stages.data() + i * kStagesWords, first, kStagesWords * sizeof(uint32_t));
        }
    }
    return nb::make_tuple(outputs, stages, statuses);
}

nb::object self_test(const nb::bytes &blob)
{
    const std::vector<uint64_t> bytes = aligned(blob);
    aminn_model_t model;
    std::vector<aminn_t> ctx(1);
    aminn_status_t status = aminn_model_from_blob(bytes.data(), blob.size(), &model);
    status = status == AMINN_OK ? aminn_init(ctx.data(), &model, 0) : status;
    status = status == AMINN_OK ? aminn_self_test(ctx.data()) : status;
    return nb::int_(static_cast<int>(status));
}

} // namespace

NB_MODULE(_runtime, m)
{
    m.doc() = "The C runtime: predictions from a binary model, bit by bit those of every other build of it.";
    m.attr("hand") = nb::make_tuple(AMINN_N_BRANCH, AMINN_N_COORD, AMINN_N_JOINT, AMINN_N_CONTACT_FEATURE,
                                    AMINN_N_WRENCH, AMINN_N_GATED, AMINN_N_TWIST); // as a model states them
    m.def("run", &run, nb::arg("blob"), nb::arg("numbers"),
          "Predict with both stages from rows of float32: those of aminn_state_t or aminn_input_t. Returns\n"
          "(outputs (n, .) uint32, stages (n, .) uint32, status (n, 1) int32): the words of aminn_output_t and of\n"
          "both aminn_stage_debug_t, zeros after an error. ValueError if the model is refused.");
    m.def("self_test", &self_test, nb::arg("blob"), "Status code of loading a model and of aminn_self_test().");
    m.def("status_name", &aminn_status_name, nb::arg("status"), "Name of a status code.");
    m.def("status_text", &aminn_status_text, nb::arg("status"), "Meaning of a status code.");
    m.def("field_name", &aminn_field_name, nb::arg("index"), "Name of a number of aminn_state_t.");
    m.def("version", &aminn_version, "Version of the library.");
}
