"""The laboratory's signature on a certificate.

A DCC gets an XML signature in the document itself (XMLDSig, enveloped), a PDF a PAdES baseline signature that
allows no change. `key` is a private key, RSA or of an elliptic curve, PEM without a password; `certificate`
is X.509 of that key, or the chain up from it, PEM.
"""

import io
from importlib.util import find_spec
from pathlib import Path

from calrig.errors import WorkError

FIELD = "Laboratory"


class SignerMissingError(WorkError):
    """What signs is not installed."""


def signed_dcc(xml: bytes, key: Path, certificate: Path) -> bytes:
    """A DCC with the signature at its end, as the schema has it; the certificate goes along.

    Raises:
        SignerMissingError: signxml is not installed.
        WorkError: a file cannot be read, is none such, or the two do not belong together.
    """
    try:
        from lxml import etree
        from signxml.signer import XMLSigner
        from signxml.verifier import XMLVerifier
    except ImportError as error:
        raise SignerMissingError("signing a DCC needs `pip install 'calrig[sign]'`") from error
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


def signed_pdf(pdf: bytes, key: Path, certificate: Path) -> bytes:
    """Return a PDF and, after its bytes, the laboratory's signature, which is not visible on paper.

    It stays PDF/A-3.

    Raises:
        SignerMissingError: pyHanko is not installed.
        WorkError: a file cannot be read, or is none such.
    """
    if find_spec("pyhanko") is None:
        raise SignerMissingError("signing a PDF needs `pip install 'calrig[sign]'`")
    from pyhanko.keys import load_certs_from_pemder, load_private_key_from_pemder
    from pyhanko.pdf_utils.incremental_writer import IncrementalPdfFileWriter
    from pyhanko.sign import fields, signers
    from pyhanko_certvalidator.registry import SimpleCertificateStore

    class Unchanged(IncrementalPdfFileWriter):
        def _update_meta(self) -> None:
            """Keep the metadata: pyHanko would write the XMP that PDF/A prescribes in another form."""

    try:
        of_key, *chain = load_certs_from_pemder([str(certificate)])  # type: ignore[no-untyped-call]
        signer = signers.SimpleSigner(
            signing_cert=of_key,
            signing_key=load_private_key_from_pemder(str(key), passphrase=None),
            cert_registry=SimpleCertificateStore.from_certs(chain),  # type: ignore[no-untyped-call]
        )
        how = signers.PdfSignatureMetadata(
            field_name=FIELD,
            md_algorithm="sha256",
            certify=True,
            subfilter=fields.SigSeedSubFilter.PADES,
            docmdp_permissions=fields.MDPPerm.NO_CHANGES,
        )
        signed = signers.sign_pdf(Unchanged(io.BytesIO(pdf)), how, signer)
    except Exception as error:
        raise WorkError(f"{key} and {certificate}: cannot be signed with ({error})") from error
    return bytes(signed.getvalue())
