// Light on a Vulkan device of the application's: its command buffers and fences, two frames in flight, no wait between.
#include <cmath>
#include <cstdio>
#include <cstring>

#include "patchlight.hpp"

namespace {

int messages = 0;

VkBool32 VKAPI_PTR on_message(VkDebugUtilsMessageSeverityFlagBitsEXT, VkDebugUtilsMessageTypeFlagsEXT,
                              const VkDebugUtilsMessengerCallbackDataEXT* data, void*) {
  std::fprintf(stderr, "%s\n", data->pMessage);
  ++messages;
  return VK_FALSE;
}

void check(VkResult result, const char* what) {
  if (result != VK_SUCCESS) throw std::runtime_error(std::string(what) + " gave " + std::to_string(result));
}

bool has_layer(const char* name) {
  uint32_t count = 0;
  vkEnumerateInstanceLayerProperties(&count, nullptr);
  std::vector<VkLayerProperties> layers(count);
  vkEnumerateInstanceLayerProperties(&count, layers.data());
  for (const auto& layer : layers)
    if (std::strcmp(layer.layerName, name) == 0) return true;
  return false;
}

}  // namespace

int main() try {
  const char* layer = "VK_LAYER_KHRONOS_validation";
  const bool is_watched = has_layer(layer);
  const char* extension = VK_EXT_DEBUG_UTILS_EXTENSION_NAME;
  VkApplicationInfo app{VK_STRUCTURE_TYPE_APPLICATION_INFO, nullptr, "own_device", 0, nullptr, 0, VK_API_VERSION_1_2};
  VkInstanceCreateInfo create{VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO};
  create.pApplicationInfo = &app;
  create.enabledLayerCount = is_watched;
  create.ppEnabledLayerNames = &layer;
  create.enabledExtensionCount = is_watched;
  create.ppEnabledExtensionNames = &extension;
  VkInstance instance;
  check(vkCreateInstance(&create, nullptr, &instance), "vkCreateInstance");
  VkDebugUtilsMessengerEXT messenger = VK_NULL_HANDLE;
  if (is_watched) {
    VkDebugUtilsMessengerCreateInfoEXT info{VK_STRUCTURE_TYPE_DEBUG_UTILS_MESSENGER_CREATE_INFO_EXT};
    info.messageSeverity = VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT;
    info.messageType = VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT;
    info.pfnUserCallback = on_message;
    auto make = reinterpret_cast<PFN_vkCreateDebugUtilsMessengerEXT>(
        vkGetInstanceProcAddr(instance, "vkCreateDebugUtilsMessengerEXT"));
    check(make(instance, &info, nullptr, &messenger), "vkCreateDebugUtilsMessengerEXT");
  }

  uint32_t count = 1;
  VkPhysicalDevice physical;
  const VkResult found = vkEnumeratePhysicalDevices(instance, &count, &physical);
  if ((found != VK_SUCCESS && found != VK_INCOMPLETE) || count == 0) throw std::runtime_error("no Vulkan device");
  VkPhysicalDeviceFeatures supported{}, features{};
  vkGetPhysicalDeviceFeatures(physical, &supported);
  VkPhysicalDeviceVulkan12Features vulkan12{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES};
  patchlight::check(pl_vulkan_enable_features(&supported, &features, &vulkan12));
  const float priority = 1.0f;
  VkDeviceQueueCreateInfo queues{VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO, nullptr, 0, 0, 1, &priority};
  VkDeviceCreateInfo device_info{VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO, &vulkan12, 0, 1, &queues};
  device_info.pEnabledFeatures = &features;
  VkDevice device;
  check(vkCreateDevice(physical, &device_info, nullptr, &device), "vkCreateDevice");
  VkQueue queue;
  vkGetDeviceQueue(device, 0, 0, &queue);
  VkCommandPoolCreateInfo pool_info{VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO, nullptr,
                                    VK_COMMAND_POOL_CREATE_RESET_COMMAND_BUFFER_BIT, 0};
  VkCommandPool pool;
  check(vkCreateCommandPool(device, &pool_info, nullptr, &pool), "vkCreateCommandPool");
  VkCommandBufferAllocateInfo two{VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO, nullptr, pool,
                                  VK_COMMAND_BUFFER_LEVEL_PRIMARY, 2};
  VkCommandBuffer commands[2];
  check(vkAllocateCommandBuffers(device, &two, commands), "vkAllocateCommandBuffers");
  VkFenceCreateInfo signalled{VK_STRUCTURE_TYPE_FENCE_CREATE_INFO, nullptr, VK_FENCE_CREATE_SIGNALED_BIT};
  VkFence fences[2];
  for (VkFence& fence : fences) check(vkCreateFence(device, &signalled, nullptr, &fence), "vkCreateFence");

  {
    const auto scene = patchlight::Scene::load("cornell");
    auto settings = patchlight::Bake::settings();
    settings.patch_count = 150;
    settings.receiver_rays = 128;
    const patchlight::Bake bake(scene, settings);
    PlBorrowedDevice own;
    pl_borrowed_device_default(&own);
    own.get_instance_proc_addr = vkGetInstanceProcAddr;
    own.instance = instance;
    own.physical_device = physical;
    own.device = device;
    own.queue = queue;
    own.features = &features;
    own.vulkan_1_2 = &vulkan12;
    patchlight::LightField field(bake, patchlight::LightField::settings(), own);
    PlLight lamp = patchlight::rectangle({0.343f, 0.5478f, 0.227f}, {-0.13f, 0, 0}, {0, 0, 0.105f}, {17, 12, 4});
    for (uint32_t frame = 0; frame < 6; ++frame) {
      const uint32_t slot = frame % 2;
      check(vkWaitForFences(device, 1, &fences[slot], VK_TRUE, UINT64_MAX), "vkWaitForFences");
      check(vkResetFences(device, 1, &fences[slot]), "vkResetFences");
      VkCommandBufferBeginInfo begin{VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO};
      check(vkBeginCommandBuffer(commands[slot], &begin), "vkBeginCommandBuffer");
      for (float& channel : lamp.color) channel *= 1.1f;
      field.set_lights({lamp});
      field.record(commands[slot], slot);
      check(vkEndCommandBuffer(commands[slot]), "vkEndCommandBuffer");
      VkSubmitInfo submit{VK_STRUCTURE_TYPE_SUBMIT_INFO};
      submit.commandBufferCount = 1;
      submit.pCommandBuffers = &commands[slot];
      check(vkQueueSubmit(queue, 1, &submit, fences[slot]), "vkQueueSubmit");
    }
    check(vkWaitForFences(device, 2, fences, VK_TRUE, UINT64_MAX), "vkWaitForFences");
    const auto light = field.surface(bake.counts().points);
    PlField* none = nullptr;
    if (pl_field_new(bake.get(), nullptr, "no such device", &none) != PL_DEVICE || !std::strstr(pl_last_error(), "no such device"))
      throw std::runtime_error("a device that is not there was opened");
    // The same light by the processor.
    patchlight::LightField other(bake);
    other.set_lights({lamp});
    other.update();
    const auto expected = other.surface(bake.counts().points);
    double apart = 0, whole = 0;
    for (std::size_t k = 0; k < light.size(); ++k) {
      apart += std::pow(light[k] - expected[k], 2);
      whole += std::pow(expected[k], 2);
    }
    const double error = std::sqrt(apart / whole);
    std::printf("%zu values in a buffer of %llu bytes, %.1e from the processor's\n", light.size() / 3,
                static_cast<unsigned long long>(field.buffer(PL_SURFACE).bytes), error);
    if (!(whole > 0 && error < 1e-4)) throw std::runtime_error("the light is another one");
  }

  for (VkFence fence : fences) vkDestroyFence(device, fence, nullptr);
  vkDestroyCommandPool(device, pool, nullptr);
  vkDestroyDevice(device, nullptr);
  if (messenger) {
    auto end = reinterpret_cast<PFN_vkDestroyDebugUtilsMessengerEXT>(
        vkGetInstanceProcAddr(instance, "vkDestroyDebugUtilsMessengerEXT"));
    end(instance, messenger, nullptr);
  }
  vkDestroyInstance(instance, nullptr);
  std::printf("validation: %s, %d messages\n", is_watched ? "on" : "not installed", messages);
  return messages == 0 ? 0 : 1;
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
