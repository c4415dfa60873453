"""The laboratory's signature on a PDF: a PAdES baseline signature that allows no change."""

from __future__ import annotations

import io
from importlib.util import find_spec
from pathlib import Path

from calrig.errors import WorkError
from calrig.export.dcc.signing import SignerMissingError

NEEDS = "signing a PDF needs `pip install 'calrig[sign]'`"
FIELD = "Laboratory"


def require_signer() -> None:
    """Raise SignerMissingError where pyHanko is not installed."""
    if find_spec("pyhanko") is None:
        raise SignerMissingError(NEEDS)


def signed_pdf(pdf: bytes, key: Path, certificate: Path) -> bytes:
    """Return a PDF and, after its bytes, the laboratory's signature, which is not visible on paper.

    Args:
        pdf: PDF/A-3, which it stays.
        key: private key, RSA or of an elliptic curve, PEM without a password.
        certificate: X.509 of that key, or the chain up from it, PEM.

    Raises:
        SignerMissingError: pyHanko is not installed.
        WorkError: a file cannot be read, or is none such.
    """
    require_signer()
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
