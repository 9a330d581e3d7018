// The fuzz targets without libFuzzer, for `make test`: inputs are changed at random, with the target's own mutator and from its
// seeds, and nothing guides them. The same inputs each time.
//
//   try_TARGET EXECUTIONS MAX_LEN [FOLDER OF SEEDS]
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <vector>

#include "mutate.hpp"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
extern "C" size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t max_size, unsigned int seed);

namespace {

fuzz::Random random_bytes(1);

using Input = std::vector<uint8_t>;

std::vector<Input> seeds_in(const char *folder)
{
    std::vector<std::filesystem::path> files;
    if (folder != nullptr) {
        for (const auto &entry : std::filesystem::directory_iterator(folder)) {
            files.push_back(entry.path());
        }
    }
    std::sort(files.begin(), files.end());
    std::vector<Input> seeds(1); // an empty one, too
    for (const auto &file : files) {
        std::ifstream stream(file, std::ios::binary);
        seeds.emplace_back(std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>());
    }
    return seeds;
}

} // namespace

// some bytes changed, a few put in, or the end cut off
extern "C" size_t LLVMFuzzerMutate(uint8_t *data, size_t size, size_t max_size)
{
    using fuzz::below;
    if (size == 0 || below(random_bytes, 8) == 0) {
        for (size_t n = 1 + below(random_bytes, 16); n > 0 && size < max_size; --n) {
            data[size++] = static_cast<uint8_t>(below(random_bytes, 256));
        }
    } else if (below(random_bytes, 8) == 0) {
        size = below(random_bytes, size) + 1;
    }
    for (size_t n = below(random_bytes, 4); n > 0 && size > 0; --n) {
        data[below(random_bytes, size)] ^= static_cast<uint8_t>(1u << below(random_bytes, 8));
    }
    return size;
}

int main(int argc, char **argv)
{
    if (argc < 3) {
        std::fprintf(stderr, "usage: %s EXECUTIONS MAX_LEN [FOLDER]\n", argv[0]);
        return 2;
    }
    const long executions = std::atol(argv[1]);
    const auto max_len = static_cast<size_t>(std::atol(argv[2]));
    std::vector<Input> pool = seeds_in(argc > 3 ? argv[3] : nullptr);
    const size_t n_seeds = pool.size();
    pool.resize(n_seeds + 64, pool.back()); // wander off, and begin anew now and then
    for (long i = 0; i < executions; ++i) {
        const size_t from = fuzz::below(random_bytes, fuzz::below(random_bytes, 4) == 0 ? n_seeds : pool.size());
        Input &wanderer = pool[n_seeds + fuzz::below(random_bytes, 64)];
        Input input = pool[from];
        const size_t size = input.size();
        input.resize(std::max(size, max_len));
        input.resize(LLVMFuzzerCustomMutator(input.data(), size, max_len, static_cast<unsigned>(random_bytes())));
        const Input exact(input); // so long and no longer
        LLVMFuzzerTestOneInput(exact.data(), exact.size());
        wanderer = exact;
    }
    std::printf("%ld executions, as promised\n", executions);
    return 0;
}
