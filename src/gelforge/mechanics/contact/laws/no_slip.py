"""No slip, the assumption of FEATS' paper."""

from gelforge.mechanics.contact.law import ContactLaw


class NoSlip(ContactLaw):
    """Each point of the gel sticks where it first touched until it is pulled off."""

    name, sticks, slips = "no_slip", True, False
