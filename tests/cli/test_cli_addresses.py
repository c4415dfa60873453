"""Who is asked at which address: the token goes nowhere else, and what is amiss is said with what to do."""

from __future__ import annotations

import ssl
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from ipaddress import ip_address
from pathlib import Path

import pytest
from command_line import reason
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from support import at_work

import calrig
from calrig.client import Refused, Unreachable
from calrig.errors import InputError


class Stranger(ThreadingHTTPServer):
    """Answers whatever it is asked with what it was told, and notes which token it was shown."""

    def __init__(self, answer: str, leads_to: str | None = None) -> None:
        super().__init__(("127.0.0.1", 0), _Answer)
        self.answer, self.leads_to = answer.encode(), leads_to
        self.heard: list[tuple[str, str | None]] = []
        self.port = self.server_address[1]


class _Answer(BaseHTTPRequestHandler):
    server: Stranger

    def do_GET(self) -> None:
        self.rfile.read(int(self.headers["Content-Length"] or 0))
        self.server.heard.append((self.command, self.headers["Authorization"]))
        self.send_response(200 if self.server.leads_to is None else 302)
        self.send_header("Content-Length", str(len(self.server.answer)))
        if self.server.leads_to is not None:
            self.send_header("Location", self.server.leads_to)
        self.end_headers()
        self.wfile.write(self.server.answer)

    def do_POST(self) -> None:
        self.do_GET()

    def log_message(self, *_: object) -> None:
        pass


def self_signed(folder: Path) -> tuple[Path, Path]:
    """A certificate of 127.0.0.1 that nobody has signed, and its key."""
    key, now = ec.generate_private_key(ec.SECP256R1()), datetime.now(UTC)
    of = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "lab")])
    builder = x509.CertificateBuilder(of, of, key.public_key(), 1, now, now + timedelta(days=2))
    names = x509.SubjectAlternativeName([x509.IPAddress(ip_address("127.0.0.1"))])
    pem, files = serialization.Encoding.PEM, (folder / "cert.pem", folder / "key.pem")
    files[0].write_bytes(builder.add_extension(names, False).sign(key, hashes.SHA256()).public_bytes(pem))
    secret = key.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    files[1].write_bytes(secret)
    return files


@pytest.mark.parametrize(
    "address",
    [
        "lab-pc:8000",
        "http://",
        "http://[::1",
        "http://lab:99999",
        "http://lab:x",
        "http://a b",
        "http://a?b=c",
    ],
)
def test_what_is_no_address_is_said_before_anything_is_sent(address):
    with pytest.raises(InputError, match="is no address such as http://lab-pc:8000"):
        calrig.Client(address)


def test_a_password_in_an_address_is_refused_and_not_repeated():
    with pytest.raises(InputError, match="CALRIG_TOKEN") as refused:
        calrig.Client("http://ada:secret@lab-pc:8000")
    assert "secret" not in str(refused.value)


def test_nobody_is_asked_where_a_redirection_leads():
    with at_work(Stranger("[]")) as elsewhere:
        to = f"http://127.0.0.1:{elsewhere.port}/"
        with at_work(Stranger("", leads_to=to)) as named:
            client = calrig.Client(f"http://127.0.0.1:{named.port}", token="secret")
            for ask in (client.rigs, lambda: client.calibrate("A")):
                with pytest.raises(Refused, match=f"sends on to {to}: name that address"):
                    ask()
            assert named.heard == [("GET", "Bearer secret"), ("POST", "Bearer secret")]
        assert elsewhere.heard == []


def test_whoever_is_not_calrig_is_said_to_be_so(folder):
    (folder / "poses.csv").write_text("target_deg,reading_deg\n0,0\n")
    for answer in ("[]", "no JSON"):
        with at_work(Stranger(answer)) as stranger:
            at = "--server", f"http://127.0.0.1:{stranger.port}"
            for command in (
                ("run", "--unit", "A"),
                ("watch", "abcdef"),
                ("import", "poses.csv", "--unit", "A"),
                ("export", "abcdef"),
                ("users", "add", "ada", "--role", "viewer"),
            ):
                assert "not as calrig does" in reason(*command, *at, status=1), (answer, command)


def test_a_certificate_of_the_labs_own_is_believed_where_it_is_named(tmp_path: Path):
    certificate, key = self_signed(tmp_path)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    stranger = Stranger("[]")
    stranger.socket = context.wrap_socket(stranger.socket, server_side=True, do_handshake_on_connect=False)
    with at_work(stranger):
        address = f"https://127.0.0.1:{stranger.port}"
        with pytest.raises(Unreachable, match=r"certificate.* SSL_CERT_FILE"):
            calrig.Client(address).rigs()
        assert stranger.heard == []
        believed = ssl.create_default_context(cafile=certificate)
        assert calrig.Client(address, believed, token="secret").rigs() == []
        assert stranger.heard == [("GET", "Bearer secret")]
    with at_work(Stranger("[]")) as plain, pytest.raises(Unreachable, match=r"does not speak TLS.* http://"):
        calrig.Client(f"https://127.0.0.1:{plain.port}").rigs()
