// What the library must be able to do with weights that are not float32. A C model names the one that it needs, and a
// linker leaves the others out.
#ifndef AMINN_SRC_STORAGE_HPP
#define AMINN_SRC_STORAGE_HPP

#include "core.hpp"

struct aminn_storage {
    uint32_t weight_type;
    bool (*sound)(const void *w, uint32_t n); // whether these weights are numbers
#if !AMINN_LANES
    // a layer, as dense() of dense.hpp
    void (*dense)(const aminn_model_t &model, const void *w, const float *b, const float *x, int n_in, int n_out,
                  float floor, float *y);
#endif
};

#if AMINN_LANES
#define AMINN_STORAGE(type, sound, Weight) {type, sound}
#else
#define AMINN_STORAGE(type, sound, Weight) {type, sound, aminn::dense_stored<Weight>}
#endif

#endif
