import asyncio

import pytest
from starlette.responses import JSONResponse
from starlette.routing import Route, WebSocketRoute
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from hmi_marl.people.web import limits
from hmi_marl.people.web.limits import RateLimit, client_address
from hmi_marl.people.web.pages import Site, tag
from hmi_marl.people.web.server import make_app
from hmi_marl.people.web.settings import Limits, ServerSettings
from hmi_marl.people.web.texts import Texts


async def echo(request):
    form = await request.body()
    return JSONResponse({"path": request.url.path, "body": form.decode()})


async def fails(request):
    raise RuntimeError("secret of the inside")


async def full(request):
    raise OSError("people.db: database or disk is full")


async def socket(websocket):
    await websocket.accept()
    await websocket.send_text("in")
    await websocket.close()


def client_of(trust_proxy=False, base_path="", **most):
    site = Site(ServerSettings(base_path=base_path, trust_proxy=trust_proxy), Texts("play"))

    async def first(request):
        return site.page("First", tag("h1", "First"))

    routes = [
        Route("/", first),
        Route("/echo", echo, methods=["GET", "POST"]),
        Route("/fails", fails),
        Route("/full", full),
        WebSocketRoute("/socket", socket),
    ]
    app = make_app(site, routes, {}, Limits(**most))
    return TestClient(app, "http://testserver", raise_server_exceptions=False)


def test_every_answer_has_the_headers_and_pages_have_nothing_inline():
    client = client_of()
    for path in ("/", "/echo", "/missing", "/fails", "/static/web/site.css", "/health"):
        headers = client.get(path).headers
        assert "default-src 'self'" in headers["content-security-policy"]
        assert "unsafe" not in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "same-origin"
    page = client.get("/").text
    assert "style=" not in page
    assert "<style" not in page
    assert page.count("<script") == page.count('<script type="module" src=')
    assert "http://" not in page


def test_errors_are_pages_that_show_nothing_of_the_inside():
    client = client_of()
    missing, bug = client.get("/missing"), client.get("/fails")
    assert missing.status_code == 404
    assert "There is no such page." in missing.text
    assert bug.status_code == 500
    assert "secret" not in bug.text
    assert 'role="alert"' in bug.text


def test_each_address_has_requests_of_its_own():
    client = client_of(trust_proxy=True, requests=0.1)

    def ask(address):
        return client.get("/health", headers={"x-forwarded-for": f"6.6.6.6, {address}"})

    assert ask("1.1.1.1").status_code == 200
    refused = ask("1.1.1.1")
    assert refused.status_code == 429
    assert refused.headers["retry-after"] == "1"
    assert ask("2.2.2.2").status_code == 200


def test_a_forwarded_address_counts_only_behind_a_trusted_proxy():
    client = client_of(requests=0.1)
    assert client.get("/health", headers={"x-forwarded-for": "1.1.1.1"}).status_code == 200
    assert client.get("/health", headers={"x-forwarded-for": "2.2.2.2"}).status_code == 429


def test_the_address_is_the_one_that_the_proxy_saw_last():
    class Connection:
        headers = {"x-forwarded-for": "made up, 9.9.9.9"}  # noqa: RUF012
        client = None

    assert client_address(Connection, True) == "9.9.9.9"
    assert client_address(Connection, False) == ""


def test_tokens_come_back_with_time():
    now = [0.0]
    limit = RateLimit(2.0, 3.0, lambda: now[0])
    assert [limit.allow("a") for _ in range(4)] == [True, True, True, False]
    assert limit.allow("b")
    now[0] = 0.5
    assert [limit.allow("a"), limit.allow("a")] == [True, False]
    now[0] = 1e6
    assert [limit.allow("a") for _ in range(4)] == [True, True, True, False]


def test_large_forms_are_refused_also_without_a_length():
    client = client_of(message_size=100)
    assert client.post("/echo", content=b"x" * 100).json()["body"] == "x" * 100
    assert client.post("/echo", content=b"x" * 101).status_code == 413

    def parts():
        for _ in range(3):
            yield b"x" * 50

    assert client.post("/echo", content=parts()).status_code == 413
    assert client.get("/echo", headers={"content-length": "-1"}).status_code == 400


def test_long_addresses_are_refused():
    """Python takes no number of more than 4300 digits."""
    client = client_of()
    assert client.get(f"/echo?{'1' * 2000}").status_code == 200
    assert client.get(f"/echo?{'1' * 2048}").status_code == 414
    assert client.get(f"/number/{'1' * 2048}").status_code == 414


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"sec-fetch-site": "same-origin"}, 200),
        ({"sec-fetch-site": "cross-site"}, 403),
        ({"sec-fetch-site": "same-site"}, 403),
        ({"origin": "http://testserver"}, 200),
        ({"origin": "http://evil.example"}, 403),
        ({"origin": "null"}, 403),
        ({"origin": "http://evil.example", "x-forwarded-host": "evil.example"}, 403),
    ],
)
def test_pages_of_other_sites_can_neither_post_nor_connect(headers, status):
    client = client_of()
    assert client.post("/echo", headers=headers).status_code == status
    if status == 200:
        with client.websocket_connect("/socket", headers=headers) as socket:
            assert socket.receive_text() == "in"
    else:
        with (
            pytest.raises(WebSocketDisconnect),
            client.websocket_connect("/socket", headers=headers),
        ):
            pass


def test_a_trusted_proxy_names_its_host():
    client = client_of(trust_proxy=True)
    headers = {"origin": "https://lab.example", "x-forwarded-host": "lab.example"}
    assert client.post("/echo", headers=headers).status_code == 200


def test_a_proxy_may_pass_the_base_path_on_or_take_it_off():
    client = client_of(base_path="/hmi")
    for path in ("/hmi/echo", "/echo"):
        assert client.get(path).status_code == 200
    for path in ("/hmi", "/hmi/", "/"):
        page = client.get(path)
        assert page.status_code == 200
        assert 'href="/hmi/static/web/site.css' in page.text
        assert 'data-base="/hmi"' in page.text
    assert client.get("/hmi/static/web/site.css").status_code == 200
    assert client.get("/hmix/echo").status_code == 404


@pytest.mark.parametrize("origin", ["http://[", "http://[::1", "null", "http://evil"])
def test_origins_that_are_others_or_none_are_refused(origin):
    refused = client_of().post("/echo", content=b"a=1", headers={"origin": origin})
    assert refused.status_code == 403
    assert refused.headers["x-content-type-options"] == "nosniff"


def test_an_odd_slash_leads_nowhere():
    client = client_of(base_path="/hmi")
    answer = client.get("/hmi/echo/", headers={"host": "evil"}, follow_redirects=False)
    assert answer.status_code == 404


def asked(*messages):
    """What a server answers to a POST whose body comes as these messages."""
    sent, waiting = [], list(messages)

    async def receive():
        if waiting:
            return waiting.pop(0)
        return await asyncio.Event().wait()

    async def send(message):
        sent.append(message)

    scope = {
        "type": "http", "method": "POST", "path": "/echo", "raw_path": b"/echo", "root_path": "",
        "headers": [], "query_string": b"", "scheme": "http", "server": ("h", 80),
    }  # fmt: skip
    asyncio.run(client_of().app(scope, receive, send))
    return sent


def test_a_part_of_a_form_is_none():
    part = {"type": "http.request", "body": b"page=1", "more_body": True}
    assert asked(part, {"type": "http.disconnect"}) == []
    whole = asked(part, {"type": "http.request", "body": b"2", "more_body": False})
    assert whole[0]["status"] == 200
    assert b"page=12" in whole[1]["body"]


def test_a_form_that_does_not_end_is_refused(monkeypatch):
    monkeypatch.setattr(limits, "BODY_TIME", 0.02)
    refused = asked({"type": "http.request", "body": b"page=1", "more_body": True})
    assert refused[0]["status"] == 408


def test_a_disk_that_fails_is_said_in_words():
    answer = client_of().get("/full")
    assert answer.status_code == 503
    assert "cannot write to its disk" in answer.text
    assert "people.db" not in answer.text
