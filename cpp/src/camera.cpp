#include "hexservo/camera.hpp"

#include "check.hpp"

namespace hexservo {

CameraParameters<double> Camera::parameters(std::string_view key) const {
  return {focal_pixels(), placement(mount, detail::words(key, ".mount"))};
}

}  // namespace hexservo
