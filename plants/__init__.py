"""Plants that come with Zenostat besides EnergyPlus: FMUs, electric grids and heat networks.

Each is a class as `zenostat.bridge.python_plant.Plant` describes it, and runs in a process of its own.
"""
