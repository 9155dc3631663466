"""Models of earlier EnergyPlus versions: rules from version to version, and the upgrade to the engine's version."""
