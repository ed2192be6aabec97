// A CUDA driver that computes nothing and writes down what it is asked for.
#include <cuda.h>
#include <stdio.h>
#include <string.h>

static char log_text[1 << 16];
static size_t sizes[64];
static int count;
static CUcontext context;

#define SAY(...) snprintf(log_text + strlen(log_text), sizeof log_text - strlen(log_text), __VA_ARGS__)

const char *stand_in_log(void) { return log_text; }
// What is launched from now on has parameters of these sizes; nothing is written down or current yet.
void stand_in_begin(const size_t *parameter_sizes, int parameters) {
  log_text[0] = 0, context = 0, count = parameters;
  memcpy(sizes, parameter_sizes, parameters * sizeof *sizes);
}

CUresult cuGetErrorString(CUresult error, const char **words) { return *words = "out of luck", CUDA_SUCCESS; }
CUresult cuDeviceGet(CUdevice *device, int place) { return *device = place, CUDA_SUCCESS; }
CUresult cuDeviceGetAttribute(int *value, CUdevice_attribute which, CUdevice device) {
  *value = which == CU_DEVICE_ATTRIBUTE_MAX_SHARED_MEMORY_PER_BLOCK_OPTIN ? 232448 : 1;
  return CUDA_SUCCESS;
}
CUresult cuCtxGetCurrent(CUcontext *current) { return *current = context, CUDA_SUCCESS; }
CUresult cuCtxSetCurrent(CUcontext current) {
  SAY("context %zx\n", (size_t)current);
  return context = current, CUDA_SUCCESS;
}
CUresult cuDevicePrimaryCtxRetain(CUcontext *primary, CUdevice device) {
  return *primary = (CUcontext)(0x100000000 + device), CUDA_SUCCESS;
}
CUresult cuModuleLoadData(CUmodule *module, const void *image) {
  SAY("image %.3s\n", (const char *)image + 1);
  return *module = (CUmodule)0x200000000, CUDA_SUCCESS;
}
CUresult cuModuleGetFunction(CUfunction *function, CUmodule module, const char *name) {
  SAY("function %zx %s\n", (size_t)module, name);
  return *function = (CUfunction)0x300000000, strcmp(name, "no_kernel") ? CUDA_SUCCESS : CUDA_ERROR_NOT_FOUND;
}
CUresult cuFuncGetAttribute(int *value, CUfunction_attribute which, CUfunction function) {
  *value = which == CU_FUNC_ATTRIBUTE_MAX_THREADS_PER_BLOCK ? 1024 : 16 * which;
  return CUDA_SUCCESS;
}
CUresult cuFuncSetAttribute(CUfunction function, CUfunction_attribute which, int value) {
  SAY("attribute %zx %d %d\n", (size_t)function, which, value);
  return CUDA_SUCCESS;
}
CUresult cuFuncSetCacheConfig(CUfunction function, CUfunc_cache config) { return CUDA_SUCCESS; }
CUresult cuPointerGetAttribute(void *value, CUpointer_attribute which, CUdeviceptr pointer) {
  return *(CUdeviceptr *)value = pointer, CUDA_SUCCESS;
}
CUresult cuLaunchKernel(CUfunction function, unsigned x, unsigned y, unsigned z, unsigned threads, unsigned rows,
                        unsigned layers, unsigned shared, CUstream stream, void **parameters, void **extra) {
  SAY("launch %zx grid %u %u %u block %u %u %u shared %u stream %zx", (size_t)function, x, y, z, threads, rows, layers,
      shared, (size_t)stream);
  for (int each = 0; each < count; each++) {
    SAY(" ");
    for (size_t byte = 0; byte < sizes[each]; byte++)
      SAY("%02x", ((unsigned char *)parameters[each])[byte]);
  }
  SAY("\n");
  return CUDA_SUCCESS;
}
CUresult cuLaunchKernelEx(const CUlaunchConfig *config, CUfunction function, void **parameters, void **extra) {
  if (config->numAttrs)
    SAY("%u attributes\n", config->numAttrs);
  return cuLaunchKernel(function, config->gridDimX, config->gridDimY, config->gridDimZ, config->blockDimX,
                        config->blockDimY, config->blockDimZ, config->sharedMemBytes, config->hStream, parameters, extra);
}

// What Triton's own module names besides, and calls for no kernel like ours.
#define UNUSED(name, ...) \
  CUresult name(__VA_ARGS__) { return CUDA_ERROR_NOT_SUPPORTED; }
UNUSED(cuCtxGetDevice, CUdevice *device)
UNUSED(cuCtxGetLimit, size_t *value, CUlimit which)
UNUSED(cuCtxSetLimit, CUlimit which, size_t value)
UNUSED(cuDriverGetVersion, int *version)
UNUSED(cuModuleUnload, CUmodule module)
UNUSED(cuStreamIsCapturing, CUstream stream, CUstreamCaptureStatus *status)
