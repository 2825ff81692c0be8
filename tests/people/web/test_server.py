import urllib.request

import pytest

from hmi_marl.people.web.pages import Markup, Site, tag
from hmi_marl.people.web.server import ServerThread, listening, make_app
from hmi_marl.people.web.settings import Limits, ServerSettings
from hmi_marl.people.web.texts import Texts


def test_a_server_answers_at_a_free_port_and_ends():
    settings = ServerSettings(port=0, base_path="/hmi")
    server = ServerThread(make_app(Site(settings, Texts("play")), [], {}), settings)
    address = server.start()
    try:
        assert address.startswith("http://127.0.0.1:")
        assert address.endswith("/hmi/")
        with urllib.request.urlopen(f"{address}health") as answer:
            assert answer.read() == b"ok"
            assert "server" not in answer.headers
    finally:
        server.stop()
    assert not server._thread.is_alive()


def test_an_address_in_use_or_elsewhere_is_refused_in_words():
    with listening(ServerSettings(port=0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(OSError, match=f"port {port}: .*choose another with --port"):
            listening(ServerSettings(port=port))
    with pytest.raises(OSError, match=r"--host no\.such\.host\.invalid is no address"):
        listening(ServerSettings(host="no.such.host.invalid"))


@pytest.mark.parametrize("path", ["hmi", "/hmi//x", "/a b", "/../x", "/x?y", "/x#y", '/"x'])
def test_odd_base_paths_are_refused(path):
    with pytest.raises(ValueError, match="base_path is a path such as /hmi, not"):
        ServerSettings(base_path=path)


def test_settings():
    assert ServerSettings(base_path="/").base_path == ""
    assert ServerSettings(base_path="/a/b/").base_path == "/a/b"
    assert ServerSettings(host="::1").address(1) == "http://[::1]:1/"
    assert ServerSettings(host="0.0.0.0").address(1) == "http://127.0.0.1:1/"
    with pytest.raises(ValueError, match="host is a host's name"):
        ServerSettings(host="a b")
    with pytest.raises(ValueError, match="max_visitors lies in 1"):
        Limits(max_visitors=0)


def test_elements_escape_their_texts():
    assert tag("p", '<b> & "x"', class_="a b", aria_label='"') == (
        '<p class="a b" aria-label="&quot;">&lt;b&gt; &amp; &quot;x&quot;</p>'
    )
    assert tag("p", [tag("b", "1"), None, Markup("<i></i>")]) == "<p><b>1</b><i></i></p>"
    assert tag("input", checked=True, disabled=False, value=None) == "<input checked>"
    assert isinstance(tag("br"), Markup)
