"""District heating networks as plants."""

from zenostat.plants.heat.district_heating import DistrictHeating

__all__ = ["DistrictHeating"]
