#include "mujoco_handle.hpp"

#include "contact_shapes.hpp"

#include <dlfcn.h>

#include <climits>
#include <cstring>
#include <mutex>

namespace aminn::sim {

thread_local ErrorFrame *current_error_frame = nullptr;

namespace {

void on_error(const char *message)
{
    ErrorFrame *frame = current_error_frame;
    // outside guarded() there is nothing to jump to: an exception unwinds the engine's frames
    if (frame == nullptr)
        throw MujocoError(message);
    std::strncpy(frame->message, message, sizeof frame->message - 1);
    frame->message[sizeof frame->message - 1] = '\0';
    std::longjmp(frame->environment, 1);
}

void on_warning(const char *)
{
}

std::mutex parser_mutex;

} // namespace

void install_handlers()
{
    static std::once_flag once;
    std::call_once(once, [] {
        mju_user_error = on_error;
        mju_user_warning = on_warning;
        install_contact_shapes();
    });
}

ModelPtr load_model(const std::string &path, const mjVFS *vfs)
{
    install_handlers();
    const std::lock_guard lock(parser_mutex);
    char message[1000] = "";
    mjModel *model = nullptr;
    guarded([&] { model = mj_loadXML(path.c_str(), vfs, message, sizeof message); });
    if (model == nullptr)
        throw MujocoError(path + ": " + message);
    return ModelPtr(model);
}

ModelPtr load_files(const std::map<std::string, std::string> &files, const std::string &path)
{
    const auto vfs = std::make_unique<mjVFS>();
    mj_defaultVFS(vfs.get());
    struct Empty {
        mjVFS *vfs;
        ~Empty()
        {
            mj_deleteVFS(vfs);
        }
    } const empty{vfs.get()};
    for (const auto &[name, content] : files) {
        if (content.size() > INT_MAX ||
            mj_makeEmptyFileVFS(vfs.get(), name.c_str(), static_cast<int>(content.size())) != 0)
            throw MujocoError(name + " does not fit the engine's virtual files");
        std::memcpy(vfs->filedata[mj_findFileVFS(vfs.get(), name.c_str())], content.data(), content.size());
    }
    return load_model(path, vfs.get());
}

ModelPtr copy_model(const mjModel &model)
{
    mjModel *copy = nullptr;
    guarded([&] { copy = mj_copyModel(nullptr, &model); });
    return ModelPtr(copy);
}

void copy_model(const mjModel &model, mjModel &into)
{
    guarded([&] { mj_copyModel(&into, &model); });
}

DataPtr make_data(const mjModel &model)
{
    mjData *data = nullptr;
    guarded([&] { data = mj_makeData(&model); });
    return DataPtr(data);
}

std::string engine_library()
{
    Dl_info info;
    if (dladdr(reinterpret_cast<const void *>(&mj_version), &info) == 0 || info.dli_fname == nullptr)
        throw MujocoError("the engine's library has no file");
    return info.dli_fname;
}

int id_of(const mjModel &model, mjtObj type, const std::string &name)
{
    const int id = mj_name2id(&model, type, name.c_str());
    if (id < 0)
        throw MujocoError(std::string("the model has no ") + mju_type2Str(type) + " named " + name);
    return id;
}

} // namespace aminn::sim
