"""Assistive devices: what they are, what they do to a body, and what recordings tell of them."""

from torchid.devices.action import refuse_foreign as refuse_foreign
from torchid.devices.device import Device as Device
from torchid.devices.device import Element as Element
from torchid.devices.device import Part as Part
from torchid.devices.device import SheetValue as SheetValue
from torchid.devices.device import placed as placed
from torchid.devices.findings import SheetFinding as SheetFinding
from torchid.devices.findings import device_findings as device_findings
from torchid.devices.forces import DeviceForces as DeviceForces
from torchid.devices.forces import device_forces as device_forces
from torchid.devices.forces import tells as tells
from torchid.devices.forces import told_of as told_of
from torchid.devices.identify import identify_device as identify_device
from torchid.devices.options import DeviceOptions as DeviceOptions
from torchid.devices.reading import library as library
from torchid.devices.reading import load_device as load_device
from torchid.devices.recorded import on_frames as on_frames
from torchid.devices.recorded import read_channels as read_channels
from torchid.devices.result import BodyBelief as BodyBelief
from torchid.devices.result import Determined as Determined
from torchid.devices.result import IdentifiedDevice as IdentifiedDevice
from torchid.devices.result import NotDeterminable as NotDeterminable
from torchid.devices.result import device_draws as device_draws
