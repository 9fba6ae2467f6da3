// NVIDIA's driver and run-time compiler, as far as `cuda_libraries.py` calls them, on a CPU: g++ compiles kernels, `emulator.h` runs them.
#include <dlfcn.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <fstream>
#include <map>
#include <sstream>
#include <string>

struct Dimensions {
    unsigned x, y, z;
};
using Launch = const char* (*)(void**, Dimensions, Dimensions, size_t (*)(const void*), int);
enum { SUCCESS, INVALID_VALUE = 1, OUT_OF_MEMORY = 2, NOT_FOUND = 500, LAUNCH_FAILED = 719 };
static std::map<uintptr_t, size_t> buffers;
static size_t free_bytes = size_t(4) << 30;
static int order = 4;  // emulator::ORDERS
static std::string failure;  // as on a GPU, all calls fail after an error of a kernel
static bool is_lost() { return !failure.empty(); }

static size_t bytes_at(const void* place) {
    const auto next = buffers.upper_bound(uintptr_t(place));
    if (next == buffers.begin()) { return 0; }
    const auto& [start, size] = *std::prev(next);
    return uintptr_t(place) < start + size ? start + size - uintptr_t(place) : 0;
}
static bool fits(uint64_t address, size_t size) { return size == 0 || bytes_at((void*)address) >= size; }

extern "C" {
// for tests
void emulatorFail(const char* why) { failure = why; }
void emulatorSetFreeBytes(size_t bytes) { free_bytes = bytes; }
void emulatorSetOrder(int number) { order = number; }
int emulatorCountBuffers() { return int(buffers.size()); }

int cuInit(unsigned) { return SUCCESS; }
int cuDriverGetVersion(int* version) { *version = 12080; return SUCCESS; }
int cuDeviceGetCount(int* count) { *count = 1; return SUCCESS; }
int cuDeviceGet(int* device, int number) { *device = number; return number ? INVALID_VALUE : SUCCESS; }
int cuDeviceGetName(char* name, int length, int) { snprintf(name, length, "emulated GPU"); return SUCCESS; }
int cuDeviceGetAttribute(int* value, int which, int) {
    const std::map<int, int> values = {{1, 1024}, {8, 48 << 10}, {18, 0}, {75, 9}, {76, 0}};
    if (!values.count(which)) { return INVALID_VALUE; }
    *value = values.at(which);
    return SUCCESS;
}
int cuDeviceTotalMem_v2(size_t* bytes, int) { *bytes = size_t(4) << 30; return SUCCESS; }
int cuDevicePrimaryCtxRetain(void** context, int) { *context = (void*)1; return SUCCESS; }
int cuCtxSetCurrent(void* context) { return context == (void*)1 ? SUCCESS : INVALID_VALUE; }
int cuGetErrorString(int code, const char** text) {
    *text = code == LAUNCH_FAILED ? failure.c_str() : code == OUT_OF_MEMORY ? "out of memory" : "invalid argument";
    return SUCCESS;
}
int cuModuleLoadData(void** module, const char* image) {
    *module = dlopen(image, RTLD_NOW | RTLD_LOCAL);
    if (!*module) { fprintf(stderr, "%s\n", dlerror()); }
    return *module ? SUCCESS : INVALID_VALUE;
}
int cuModuleGetFunction(void** function, void* module, const char* name) {
    *function = dlsym(module, (std::string("launch_") + name).c_str());
    return *function ? SUCCESS : NOT_FOUND;
}
int cuMemAlloc_v2(uint64_t* address, size_t size) {
    if (is_lost()) { return LAUNCH_FAILED; }
    if (size > free_bytes) { return OUT_OF_MEMORY; }
    void* place = aligned_alloc(256, (size + 255) / 256 * 256);
    memset(place, 0xff, size);  // NaN
    buffers[uintptr_t(place)] = size;
    *address = uint64_t(place);
    return SUCCESS;
}
int cuMemFree_v2(uint64_t address) {
    if (!buffers.erase(address)) { return INVALID_VALUE; }
    free((void*)address);
    return SUCCESS;
}
int cuMemsetD8_v2(uint64_t address, unsigned char value, size_t size) {
    if (is_lost()) { return LAUNCH_FAILED; }
    if (!fits(address, size)) { return INVALID_VALUE; }
    memset((void*)address, value, size);
    return SUCCESS;
}
int cuMemsetD8Async(uint64_t address, unsigned char value, size_t size, void*) { return cuMemsetD8_v2(address, value, size); }
int cuMemcpyHtoD_v2(uint64_t address, const void* data, size_t size) {
    if (is_lost()) { return LAUNCH_FAILED; }
    if (!fits(address, size)) { return INVALID_VALUE; }
    memcpy((void*)address, data, size);
    return SUCCESS;
}
int cuMemcpyDtoH_v2(void* data, uint64_t address, size_t size) {
    if (is_lost()) { return LAUNCH_FAILED; }
    if (!fits(address, size)) { return INVALID_VALUE; }
    memcpy(data, (void*)address, size);
    return SUCCESS;
}
int cuLaunchKernel(void* function, unsigned gx, unsigned gy, unsigned gz, unsigned bx, unsigned by, unsigned bz, unsigned shared,
                   void* stream, void** arguments, void** extra) {
    if (is_lost()) { return LAUNCH_FAILED; }
    if (!gx || !gy || !gz || shared || stream || extra) { return INVALID_VALUE; }
    if (const char* why = Launch(function)(arguments, {gx, gy, gz}, {bx, by, bz}, bytes_at, order)) { failure = why; }
    return SUCCESS;  // what goes wrong in a kernel is reported by later calls
}

struct Program {
    std::string source, log, image;
};
int nvrtcGetNumSupportedArchs(int* count) { *count = 2; return 0; }
int nvrtcGetSupportedArchs(int* found) { found[0] = 75; found[1] = 90; return 0; }
int nvrtcCreateProgram(void** program, const char* source, const char*, int, void*, void*) {
    *program = new Program{source, "", ""};
    return 0;
}
int nvrtcDestroyProgram(void** program) { delete (Program*)*program; return 0; }
int nvrtcCompileProgram(void* handle, int, const char* const*) {
    Program& program = *(Program*)handle;
    static int number = 0;
    const std::string folder = getenv("EMULATOR_FOLDER"), file = folder + "/kernel" + std::to_string(number++);
    std::ofstream(file + ".cpp") << "#include \"emulator.h\"\n" << program.source
        << "extern \"C\" const char* launch_entry(void** arguments, Dimensions grid, Dimensions block, size_t (*bytes)(const void*), "
        << "int order) {\n    return emulator::run(wgsl::entry, arguments, grid, block, bytes, order);\n}\n";
    const std::string options = " -std=c++17 -O1 -fPIC -shared -ffp-contract=off -U_FORTIFY_SOURCE -w -I" EMULATOR_HEADERS " ";
    const int code = system(("g++" + options + file + ".cpp -o " + file + ".so 2> " + file + ".log").c_str());
    std::stringstream log;
    log << std::ifstream(file + ".log").rdbuf();
    program.log = log.str();
    program.image = file + ".so";
    return code ? 6 : 0;
}
int nvrtcGetProgramLogSize(void* program, size_t* size) { *size = ((Program*)program)->log.size() + 1; return 0; }
int nvrtcGetProgramLog(void* program, char* log) { strcpy(log, ((Program*)program)->log.c_str()); return 0; }
int nvrtcGetCUBINSize(void* program, size_t* size) { *size = ((Program*)program)->image.size() + 1; return 0; }
int nvrtcGetCUBIN(void* program, char* image) { strcpy(image, ((Program*)program)->image.c_str()); return 0; }
int nvrtcGetPTXSize(void* program, size_t* size) { return nvrtcGetCUBINSize(program, size); }
int nvrtcGetPTX(void* program, char* image) { return nvrtcGetCUBIN(program, image); }
}
