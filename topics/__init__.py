"""The contract: key expressions, message classes, units, serialization and errors.

Besides, what all packages need of files: reading those of users, atomic writes, locks, the cache. No bus.
"""

VERSION = "0.1.0"
"""Version of Zenostat; the version of the contract is `zenostat.topics.messages.SCHEMA_VERSION`."""
