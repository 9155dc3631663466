"""The table of permissions in docs/security.md, made of the code; `python tests/support/security_page.py` writes it."""

import re
from pathlib import Path

from zenostat.bridge.transport.access_control import Permission, may
from zenostat.bridge.transport.name_list import CERTIFIED
from zenostat.topics.keys import TOPICS, Role, Topic

PAGE = Path(__file__).parents[2] / "docs" / "security.md"
BEGIN, END = "<!-- made: permissions -->\n", "\n<!-- end -->"
_BOUND = (Permission.SEND, Permission.ASK, Permission.SHOW)


def table() -> str:
    """A row for each topic, a column for each role."""
    rows = [f"| topic | {' | '.join(CERTIFIED)} |", "|---" * (len(CERTIFIED) + 1) + "|"]
    rows += [f"| `{topic.key}` | {' | '.join(cell(role, topic) for role in CERTIFIED)} |" for topic in TOPICS]
    return "\n".join(rows)


def cell(role: Role, topic: Topic) -> str:
    """The permissions of a role on a topic; those that are bound to its own name are marked."""
    words = [
        f"{permission} as itself" if role is not Role.NODE and topic.has_sender and permission in _BOUND else permission
        for permission in may(role, topic)
    ]
    return ", ".join(words) or "nothing"


def page(text: str) -> str:
    """The page with its table made anew."""
    return re.sub(f"{re.escape(BEGIN)}.*?{re.escape(END)}", f"{BEGIN}{table()}{END}", text, flags=re.DOTALL)


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
