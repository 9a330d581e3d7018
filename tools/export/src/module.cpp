// The C runtime as the Python module aminn_export._runtime: what a model's known answer is computed with.
#include <cstdint>
#include <string>

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include "aminn_rt.h"
#include "batch.hpp"

namespace nb = nanobind;

namespace {

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

nb::tuple run(const nb::bytes &blob, const Numbers &numbers)
{
    const size_t n = numbers.shape(0);
    const size_t columns = numbers.shape(1);
    if (columns != AMINN_N_STATE && columns != batch::kInputWords) {
        const std::string expected =
            std::to_string(AMINN_N_STATE) + " (a state) or " + std::to_string(batch::kInputWords) + " (an input)";
        throw nb::value_error(("numbers: expected " + expected + " a row").c_str());
    }
    Array<uint32_t> outputs = array<uint32_t>(n, batch::kOutputWords);
    Array<uint32_t> stages = array<uint32_t>(n, batch::kStagesWords);
    Array<int32_t> statuses = array<int32_t>(n, 1);
    const int32_t status = aminn_batch_run(blob.data(), blob.size(), numbers.data(), n, columns, outputs.data(),
                                           stages.data(), statuses.data());
    if (status != AMINN_OK) {
        throw nb::value_error((std::string("model: ") + aminn_status_text(status)).c_str());
    }
    return nb::make_tuple(outputs, stages, statuses);
}

int32_t self_test(const nb::bytes &blob)
{
    return aminn_batch_self_test(blob.data(), blob.size());
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
