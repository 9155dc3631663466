"""The contract: every key expression, message class and unit, their coding, and the errors.

No I/O in here.
"""

VERSION = "0.1.0"
"""Of Zenostat; the contract's own version is `topics.messages.SCHEMA_VERSION`."""
