"""Which foot stands where: frames whose support no plate measures, and the plate under each foot."""

from torchid.contact.contact import Contact as Contact
from torchid.contact.contact import ContactOptions as ContactOptions
from torchid.contact.contact import find_contact as find_contact
