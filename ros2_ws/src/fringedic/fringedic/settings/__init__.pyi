from .camera import CameraSettings as CameraSettings
from .devices import Devices as Devices
from .devices import DeviceSettings as DeviceSettings
