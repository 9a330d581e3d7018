/*
 * aminn_bench - time predictions of the runtime beside its own matrix-vector products and beside ONNX Runtime.
 *
 *   aminn_bench MODEL.bin VECTORS.bin ROUNDS ONNXRUNTIME.so AMINN.onnx MLP.onnx
 *
 * Compiled for the widths of one model (-DHC= -DTRUNK= -DH1= -DH2= -DHD=; TRUNK: inputs of a trunk), so that Eigen knows
 * the sizes. Every round times each subject on samples of the vector file, one call a sample, one thread; the subjects take
 * turns, so that a change of clock rate or a busy machine meets all of them. Prints one JSON object with, for each
 * subject, the median and the least of its times in a round (microseconds a call), and the medians of the ratios within a
 * round. Exits with 1 and a message on a bad file.
 */
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#define EIGEN_MAX_ALIGN_BYTES 64 // what the products promise, also where registers are narrower
#include <Eigen/Core>
#include <cblas.h>
#include <dlfcn.h>

#include "aminn_rt.h"
extern "C" {
#include "host_file.h"
}

namespace {

using Clock = std::chrono::steady_clock;

// --- ONNX Runtime through its C API -------------------------------------------------------------------------------
// The wheel has the library and no header. Its table of functions only ever grows at its end, so the few that are needed
// are named by their place in it; the outputs are held against the runtime's before anything is timed.
enum Place {
    kGetErrorMessage = 2,
    kCreateEnv = 3,
    kCreateSession = 7,
    kRun = 9,
    kCreateSessionOptions = 10,
    kSetGraphOptimizationLevel = 23,
    kSetIntraOpNumThreads = 24,
    kSetInterOpNumThreads = 25,
    kCreateTensorWithData = 49,
    kCreateCpuMemoryInfo = 69,
};

struct ApiBase {
    void *const *(*get_api)(uint32_t version);
    const char *(*version)();
};

class OnnxRuntime {
  public:
    explicit OnnxRuntime(const char *library)
    {
        void *handle = dlopen(library, RTLD_NOW);
        void *symbol = handle == nullptr ? nullptr : dlsym(handle, "OrtGetApiBase");
        if (symbol == nullptr) {
            die("%s: %s", library, dlerror());
        }
        base_ = reinterpret_cast<const ApiBase *(*)()>(symbol)();
        api_ = base_->get_api(11);
        call<int, const char *, void **>(kCreateEnv, 3, "aminn_bench", &env_);
        call<void **>(kCreateSessionOptions, &options_);
        call<void *, int>(kSetGraphOptimizationLevel, options_, 99);
        call<void *, int>(kSetIntraOpNumThreads, options_, 1);
        call<void *, int>(kSetInterOpNumThreads, options_, 1);
        call<int, int, void **>(kCreateCpuMemoryInfo, 0, 0, &memory_);
    }

    const char *version() const
    {
        return base_->version();
    }

    void *session(const char *file) const
    {
        void *session = nullptr;
        call<void *, const char *, void *, void **>(kCreateSession, env_, file, options_, &session);
        return session;
    }

    void *tensor(float *data, const std::vector<int64_t> &shape) const
    {
        size_t n = sizeof(float);
        for (const int64_t d : shape) {
            n *= static_cast<size_t>(d);
        }
        void *value = nullptr;
        call<void *, void *, size_t, const int64_t *, size_t, int, void **>(kCreateTensorWithData, memory_, data, n,
                                                                            shape.data(), shape.size(), 1, &value);
        return value;
    }

    void run(void *session, const std::vector<const char *> &in, const std::vector<void *> &inputs,
             const std::vector<const char *> &out, std::vector<void *> &outputs) const
    {
        call<void *, const void *, const char *const *, void *const *, size_t, const char *const *, size_t, void **>(
            kRun, session, nullptr, in.data(), inputs.data(), in.size(), out.data(), out.size(), outputs.data());
    }

  private:
    template <class... Arguments>
    void call(Place place, Arguments... arguments) const
    {
        void *status = reinterpret_cast<void *(*)(Arguments...)>(api_[place])(arguments...);
        if (status != nullptr) {
            die("ONNX Runtime: %s", reinterpret_cast<const char *(*)(void *)>(api_[kGetErrorMessage])(status));
        }
    }

    const ApiBase *base_ = nullptr;
    void *const *api_ = nullptr;
    void *env_ = nullptr;
    void *options_ = nullptr;
    void *memory_ = nullptr;
};

// --- subjects -----------------------------------------------------------------------------------------------------

const float *samples;
size_t n_samples;
size_t sample_step; // theirs, and that of sensors behind them, which are not told to anyone

const float *sample(size_t i)
{
    return samples + i * sample_step;
}

struct Products {
    int in, out;
};
constexpr int kBackbone = 4;
constexpr Products kProducts[] = {{AMINN_N_CONTACT_INPUT, HC}, {TRUNK, H1}, {H1, H1}, {H1, AMINN_N_HEAD},
                                  {AMINN_N_CONTACT_INPUT, HC}, {TRUNK, H2}, {H2, H2}, {H2, AMINN_N_HEAD},
                                  {H1 + AMINN_N_AUX, HD},      {HD, 1}};
constexpr int kCount = sizeof kProducts / sizeof kProducts[0];
alignas(64) float x[256];
alignas(64) float y[256];
std::vector<std::vector<float, Eigen::aligned_allocator<float>>> weights;

template <int kIn, int kOut>
void eigen_product(int i)
{
    const Eigen::Map<const Eigen::Matrix<float, kOut, kIn>, Eigen::Aligned64> w(weights[static_cast<size_t>(i)].data());
    const Eigen::Map<const Eigen::Matrix<float, kIn, 1>, Eigen::Aligned64> v(x);
    Eigen::Map<Eigen::Matrix<float, kOut, 1>, Eigen::Aligned64> out(y);
    out.noalias() = w * v;
}

template <int kWidth>
void eigen_backbone(int first)
{
    eigen_product<AMINN_N_CONTACT_INPUT, HC>(first);
    eigen_product<TRUNK, kWidth>(first + 1);
    eigen_product<kWidth, kWidth>(first + 2);
    eigen_product<kWidth, AMINN_N_HEAD>(first + 3);
}

void eigen_fixed(size_t)
{
    eigen_backbone<H1>(0);
    eigen_backbone<H2>(kBackbone);
    eigen_product<H1 + AMINN_N_AUX, HD>(2 * kBackbone);
    y[0] = Eigen::Map<const Eigen::Matrix<float, HD, 1>>(weights[2 * kBackbone + 1].data())
               .dot(Eigen::Map<const Eigen::Matrix<float, HD, 1>>(x));
}

void eigen_dynamic(size_t)
{
    for (int i = 0; i < kCount; ++i) {
        const Eigen::Map<const Eigen::MatrixXf> w(weights[static_cast<size_t>(i)].data(), kProducts[i].out,
                                                  kProducts[i].in);
        Eigen::Map<Eigen::VectorXf>(y, kProducts[i].out).noalias() =
            w * Eigen::Map<const Eigen::VectorXf>(x, kProducts[i].in);
    }
}

void openblas(size_t)
{
    for (int i = 0; i < kCount; ++i) {
        const auto &p = kProducts[i];
        cblas_sgemv(CblasColMajor, CblasNoTrans, p.out, p.in, 1.0F, weights[static_cast<size_t>(i)].data(), p.out, x, 1,
                    0.0F, y, 1);
    }
}

void openblas_transposed(size_t)
{
    for (int i = 0; i < kCount; ++i) {
        const auto &p = kProducts[i];
        cblas_sgemv(CblasRowMajor, CblasNoTrans, p.out, p.in, 1.0F, weights[static_cast<size_t>(i)].data(), p.in, x, 1,
                    0.0F, y, 1);
    }
}

aminn_t both, gated;
aminn_output_t out;
aminn_input_t in;

void check(aminn_status_t status)
{
    if (status != AMINN_OK) {
        die("the runtime refuses a sample: %s", aminn_status_name(status));
    }
}

void predict_both(size_t i)
{
    std::memcpy(&in, sample(i), sizeof in);
    check(aminn_predict(&both, &in, &out));
}

void predict_gated(size_t i)
{
    std::memcpy(&in, sample(i), sizeof in);
    check(aminn_predict(&gated, &in, &out));
}

void predict_state(size_t i)
{
    aminn_state_t state;
    std::memcpy(&state, sample(i), sizeof state);
    check(aminn_predict_state(&both, &state, &out));
}

const OnnxRuntime *ort;
struct Graph {
    void *session;
    std::vector<const char *> in_names, out_names;
    std::vector<void *> inputs, outputs;
};
Graph aminn_graph, mlp_graph;
aminn_input_t graph_input; // its floats are the MLP's input too
float graph_output[VECTOR_N_OUT];

void onnx_aminn(size_t i)
{
    std::memcpy(&graph_input, sample(i), sizeof graph_input);
    ort->run(aminn_graph.session, aminn_graph.in_names, aminn_graph.inputs, aminn_graph.out_names, aminn_graph.outputs);
}

void onnx_mlp(size_t i)
{
    std::memcpy(&graph_input, sample(i), sizeof graph_input);
    ort->run(mlp_graph.session, mlp_graph.in_names, mlp_graph.inputs, mlp_graph.out_names, mlp_graph.outputs);
}

void open_graphs(const char *aminn_file, const char *mlp_file)
{
    static float mlp_output[7];
    aminn_input_t &g = graph_input;
    aminn_graph = {ort->session(aminn_file),
                   {"q", "x_ht", "w_e", "contacts", "j_x", "j_q"},
                   {"p_stable", "dx_ht", "k_x", "gate", "p_slide", "bound_95", "friction_use"},
                   {ort->tensor(g.q, {1, AMINN_N_JOINT}), ort->tensor(g.x_ht, {1, AMINN_N_WRENCH}),
                    ort->tensor(g.w_e, {1, AMINN_N_WRENCH}),
                    ort->tensor(g.contacts[0], {1, AMINN_N_BRANCH, AMINN_N_CONTACT_FEATURE}),
                    ort->tensor(g.j_x[0][0], {1, AMINN_N_BRANCH, 3, AMINN_N_WRENCH}),
                    ort->tensor(g.j_q[0][0], {1, AMINN_N_BRANCH, 3, AMINN_N_COORD})},
                   {ort->tensor(graph_output, {1}), ort->tensor(graph_output + 1, {1, 6}),
                    ort->tensor(graph_output + 7, {1, 6, 6}), ort->tensor(graph_output + 43, {1, AMINN_N_BRANCH}),
                    ort->tensor(graph_output + 43 + AMINN_N_BRANCH, {1}),
                    ort->tensor(graph_output + 44 + AMINN_N_BRANCH, {1}),
                    ort->tensor(graph_output + 45 + AMINN_N_BRANCH, {1, AMINN_N_BRANCH})}};
    mlp_graph = {
        ort->session(mlp_file), {"x"}, {"y"}, {ort->tensor(g.q, {1, VECTOR_N_IN})}, {ort->tensor(mlp_output, {1, 7})}};
}

void check_graph()
{
    onnx_aminn(0);
    predict_both(0);
    for (int i = 0; i < AMINN_N_WRENCH; ++i) {
        const float allowed = 1e-3F * std::fabs(out.dx_ht[i]) + 1e-7F;
        if (!(std::fabs(graph_output[1 + i] - out.dx_ht[i]) <= allowed)) {
            die("ONNX Runtime's dx_ht is not the runtime's: its interface is not what this program expects");
        }
    }
}

struct Subject {
    const char *name;
    void (*call)(size_t);
    size_t calls;              // in a round: well below the time that another program takes the processor away for
    std::vector<double> times; // of the rounds, microseconds a call
};

constexpr size_t kCalls = 200;
Subject subjects[] = {
    {"floor_eigen_fixed", eigen_fixed, kCalls, {}},
    {"floor_eigen_dynamic", eigen_dynamic, kCalls, {}},
    {"floor_openblas", openblas, kCalls, {}},
    {"floor_openblas_transposed", openblas_transposed, kCalls, {}},
    {"runtime_both_stages", predict_both, kCalls, {}},
    {"runtime_as_called", predict_gated, kCalls, {}},
    {"runtime_both_stages_and_closure", predict_state, kCalls, {}},
    {"onnx", onnx_aminn, kCalls / 50, {}},
    {"onnx_mlp", onnx_mlp, kCalls, {}},
};
enum { kFloors = 4, kRuntime = 4, kOnnx = 7, kMlp = 8 };

double median(std::vector<double> v)
{
    std::sort(v.begin(), v.end());
    return v[v.size() / 2];
}

double least(const std::vector<double> &v)
{
    return *std::min_element(v.begin(), v.end());
}

void run_round(size_t round)
{
    for (Subject &s : subjects) {
        const size_t first = round * s.calls;
        for (size_t i = 0; i < s.calls / 4 + 1; ++i) { // caches as in a loop of its own
            s.call(i % n_samples);
        }
        const auto start = Clock::now();
        for (size_t i = first; i < first + s.calls; ++i) {
            s.call(i % n_samples);
        }
        const std::chrono::duration<double, std::micro> spent = Clock::now() - start;
        s.times.push_back(spent.count() / static_cast<double>(s.calls));
    }
}

// the floor whose median is smallest
const Subject &floor_of_all()
{
    return *std::min_element(subjects, subjects + kFloors,
                             [](const Subject &a, const Subject &b) { return median(a.times) < median(b.times); });
}

double ratio(const Subject &a, const Subject &b)
{
    std::vector<double> r;
    for (size_t i = 0; i < a.times.size(); ++i) {
        r.push_back(a.times[i] / b.times[i]);
    }
    return median(r);
}

} // namespace

int main(int argc, char **argv)
{
    aminn_model_t model;
    program_name = "aminn_bench";
    const unsigned long rounds = argc == 7 ? std::strtoul(argv[3], nullptr, 10) : 0;
    if (rounds == 0 || rounds > 1000000) {
        std::fprintf(stderr, "usage: %s MODEL.bin VECTORS.bin ROUNDS ONNXRUNTIME.so AMINN.onnx MLP.onnx\n", argv[0]);
        return 2;
    }
    open_model(argv[1], &model);
    if (model.contact_width != HC || model.width[0] != H1 || model.width[1] != H2 || model.classifier_width != HD) {
        die("compiled for widths %d, %d, %d, %d; the model has %u, %u, %u, %u", HC, H1, H2, HD, model.contact_width,
            model.width[0], model.width[1], model.classifier_width);
    }
    const vector_header_t *vectors = open_vectors(argv[2]);
    samples = reinterpret_cast<const float *>(vectors + 1);
    n_samples = vectors->n;
    sample_step = vector_sample(vectors);
    if (n_samples == 0) {
        die("%s: no samples", argv[2]);
    }
    if (vector_n_theta(vectors) != 0) {
        die("%s: samples with theta; give such as are of the nominal hand", argv[2]);
    }
    for (const Products &p : kProducts) {
        weights.emplace_back(static_cast<size_t>(p.in) * static_cast<size_t>(p.out), 0.01F);
    }
    std::fill(std::begin(x), std::end(x), 0.5F);
    openblas_set_num_threads(1);
    check(aminn_init(&both, &model, AMINN_FLAG_ALWAYS_STAGE2));
    check(aminn_init(&gated, &model, 0));
    const OnnxRuntime onnxruntime(argv[4]);
    ort = &onnxruntime;
    open_graphs(argv[5], argv[6]);
    check_graph();
    for (unsigned long i = 0; i < rounds; ++i) {
        run_round(i);
    }
    std::printf("{");
    for (const Subject &s : subjects) {
        std::printf("\"%s_us\": %.4f, \"%s_us_min\": %.4f, ", s.name, median(s.times), s.name, least(s.times));
    }
    const Subject &floor = floor_of_all();
    std::printf("\"floor\": \"%s\", \"onnxruntime_version\": \"%s\", ", floor.name, onnxruntime.version());
    std::printf("\"runtime_to_floor_ratio\": %.4f, ", ratio(subjects[kRuntime], floor));
    std::printf("\"onnx_to_runtime_ratio\": %.4f, ", ratio(subjects[kOnnx], subjects[kRuntime]));
    std::printf("\"mlp_to_runtime_ratio\": %.4f, ", ratio(subjects[kMlp], subjects[kRuntime]));
    std::printf("\"samples\": %zu, \"rounds\": %lu}\n", n_samples, rounds);
    return 0;
}
