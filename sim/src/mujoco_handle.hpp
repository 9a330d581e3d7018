// Owning handles of MuJoCo's model and data, and errors of the engine as C++ exceptions.
#pragma once

#include <mujoco/mujoco.h>

#include <csetjmp>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>

namespace aminn::sim {

// An error that MuJoCo reported. By default MuJoCo 2.2 prints it, waits for a key and ends the process.
class MujocoError : public std::runtime_error {
  public:
    using std::runtime_error::runtime_error;
};

struct ModelDeleter {
    void operator()(mjModel *m) const noexcept
    {
        mj_deleteModel(m);
    }
};
struct DataDeleter {
    void operator()(mjData *d) const noexcept
    {
        mj_deleteData(d);
    }
};
using ModelPtr = std::unique_ptr<mjModel, ModelDeleter>;
using DataPtr = std::unique_ptr<mjData, DataDeleter>;

// Where an engine error jumps to; one chain a thread.
struct ErrorFrame {
    std::jmp_buf environment;
    ErrorFrame *previous;
    char message[512];
};
extern thread_local ErrorFrame *current_error_frame;

// Installs the handlers of errors and warnings, once a process. Warnings are counted in mjData by the engine; the
// handler only keeps it from writing a log file into the working folder.
void install_handlers();

// Runs `calls`, which may only make calls of the engine (no C++ object with a destructor may be alive inside it), and
// throws MujocoError if the engine reports an error. The mjData in use is then inconsistent: reset or drop it.
template <class Calls>
void guarded(Calls &&calls)
{
    ErrorFrame frame;
    frame.previous = current_error_frame;
    current_error_frame = &frame;
    if (setjmp(frame.environment) != 0) {
        current_error_frame = frame.previous;
        throw MujocoError(frame.message);
    }
    calls();
    current_error_frame = frame.previous;
}

// Reads and compiles an MJCF file. Throws MujocoError with the parser's message. Calls are serialised: the parser is
// not reentrant. Files of `vfs` are found before those on disk.
ModelPtr load_model(const std::string &path, const mjVFS *vfs = nullptr);
// The same from files in memory, by name: `path` ends in the name of one. Files that they refer to are looked for there
// first, without their folders, and then below the folder of `path`.
ModelPtr load_files(const std::map<std::string, std::string> &files, const std::string &path);
ModelPtr copy_model(const mjModel &model);
// The same into a model of the same sizes.
void copy_model(const mjModel &model, mjModel &into);
DataPtr make_data(const mjModel &model);

// The file that the engine was loaded from.
std::string engine_library();

// Id of a named object; throws MujocoError if the model has none.
int id_of(const mjModel &model, mjtObj type, const std::string &name);

} // namespace aminn::sim
