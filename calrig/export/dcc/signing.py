"""The laboratory's signature on a DCC: an XML signature in the document itself (XMLDSig, enveloped)."""

from __future__ import annotations

from pathlib import Path

from calrig.errors import WorkError

NEEDS = "signing a DCC needs `pip install 'calrig[sign]'`"


class SignerMissingError(WorkError):
    """What signs is not installed."""


def signed(xml: bytes, key: Path, certificate: Path) -> bytes:
    """A DCC with the signature at its end, as the schema has it; the certificate goes along.

    Args:
        xml: the DCC.
        key: private key, RSA or of an elliptic curve, PEM without a password.
        certificate: X.509 of that key, or the chain up from it, PEM.

    Raises:
        SignerMissingError: signxml is not installed.
        WorkError: a file cannot be read, is none such, or the two do not belong together.
    """
    try:
        from lxml import etree
        from signxml.signer import XMLSigner
        from signxml.verifier import XMLVerifier
    except ImportError as error:
        raise SignerMissingError(NEEDS) from error
    try:
        secret, public = key.read_bytes(), certificate.read_bytes()
    except OSError as error:
        raise WorkError(f"{error.filename}: cannot be read ({error.strerror})") from error
    try:
        signer = XMLSigner(signature_algorithm=_algorithm_of(secret))
        root = signer.sign(etree.fromstring(xml), key=secret, cert=public.decode())
        made: bytes = etree.tostring(root, encoding="utf-8", xml_declaration=True)
        XMLVerifier().verify(made, x509_cert=public.decode())
    except Exception as error:
        raise WorkError(f"{key} and {certificate}: cannot be signed with ({error})") from error
    return made


def _algorithm_of(secret: bytes) -> str:
    """With SHA-256, by the kind of key."""
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    key = load_pem_private_key(secret, password=None)
    return "ecdsa-sha256" if isinstance(key, EllipticCurvePrivateKey) else "rsa-sha256"
