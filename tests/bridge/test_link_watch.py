"""The loss and the return of the only connection of a session, with real sessions."""

from pathlib import Path

from support.nodes import until

from zenostat.bridge.transport.link_watch import LinkWatch
from zenostat.bridge.transport.session import open_session


def test_link_watch__reports_the_loss_and_the_return_of_the_connection(folder: Path) -> None:
    endpoint, texts = f"unixsock-stream/{folder}/bus", list[str]()
    with open_session(listen=[endpoint]) as router, open_session(connect=[endpoint]) as session:
        watch = LinkWatch(session, [endpoint], texts.append)
        router.close()
        until(lambda: texts, "the loss is reported")
        with open_session(listen=[endpoint]):
            until(lambda: len(texts) == 2, "the return is reported")
        watch.close()
    assert texts[0].startswith(f"the connection to {endpoint} is lost, so no other program reaches this node")
    assert texts[1] == f"connected to {endpoint} again"
