"""Keys of a stage: a small authority, and a certificate for each figure.

The certificate of a figure has its name; `settings.access_control` says what that name may do. The
key of the authority (`ca.key`) stays where the keys were made and is on no computer of the stage:
with it more figures can be made.
"""

from __future__ import annotations

import datetime as dt
import os
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError, install_command

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path

    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
    from cryptography.x509 import Certificate

YEARS: Final = 10
"""Chosen: a figure is not to stop on the evening on which a certificate ends. Keys of a lost
computer are made worthless by new keys for all."""


def make_keys(stage: str, figures: Collection[str], folder: Path) -> list[Path]:
    """Write authority and keys into a new or empty `folder`; return the files.

    With an authority that is there already, only figures without keys get some.
    """
    try:
        from cryptography import x509
    except ModuleNotFoundError:
        raise InputError(f"keys need a package: {install_command('network')}") from None
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    authority, authority_key = folder / "ca.pem", folder / "ca.key"
    if authority.exists() != authority_key.exists():
        raise InputError(
            f"{folder} has one of ca.pem and ca.key only: both are needed to make more keys; "
            f"give another folder to begin anew"
        )
    if authority.exists():
        from cryptography.hazmat.primitives.serialization import load_pem_private_key

        issuer = x509.load_pem_x509_certificate(authority.read_bytes())
        issuer_key = load_pem_private_key(authority_key.read_bytes(), None)
    else:
        issuer_key = _new_key()
        issuer = _certificate(f"stage {stage}", issuer_key, None, issuer_key)
        written += [_write(authority, _pem(issuer)), _write(authority_key, _key_pem(issuer_key))]
    for name in sorted(figures):
        path, key_path = folder / f"{name}.pem", folder / f"{name}.key"
        if path.exists() or key_path.exists():
            continue
        key = _new_key()
        certificate = _certificate(name, key, issuer, issuer_key)  # type: ignore[arg-type]
        written += [_write(path, _pem(certificate)), _write(key_path, _key_pem(key))]
    return written


def _new_key() -> EllipticCurvePrivateKey:
    from cryptography.hazmat.primitives.asymmetric import ec

    return ec.generate_private_key(ec.SECP256R1())


def _certificate(
    name: str,
    key: EllipticCurvePrivateKey,
    issuer: Certificate | None,
    issuer_key: EllipticCurvePrivateKey,
) -> Certificate:
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    # A certificate is judged by wall clocks, and that of a small computer may be behind.
    begin = dt.datetime(2020, 1, 1, tzinfo=dt.UTC)
    end = dt.datetime.now(dt.UTC) + dt.timedelta(days=365 * YEARS)
    is_authority = issuer is None
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject if issuer is None else issuer.subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(begin)
        .not_valid_after(end)
        .add_extension(x509.BasicConstraints(ca=is_authority, path_length=None), critical=True)
    )
    if not is_authority:
        usages = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
        builder = builder.add_extension(x509.ExtendedKeyUsage(usages), critical=False)
        builder = builder.add_extension(
            x509.SubjectAlternativeName([x509.DNSName(name)]), critical=False
        )
    return builder.sign(issuer_key, hashes.SHA256())


def _pem(certificate: Certificate) -> bytes:
    from cryptography.hazmat.primitives.serialization import Encoding

    return certificate.public_bytes(Encoding.PEM)


def _key_pem(key: EllipticCurvePrivateKey) -> bytes:
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def _write(path: Path, content: bytes) -> Path:
    """Write a new file that only its owner may read."""
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "wb") as file:
        file.write(content)
    return path
