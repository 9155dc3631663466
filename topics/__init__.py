"""The contract: key expressions, message classes, units, serialization and errors.

Apart from reading a YAML file, no I/O.
"""

VERSION = "0.1.0"
"""Version of Zenostat; the version of the contract is `zenostat.topics.messages.SCHEMA_VERSION`."""
