//! Which addresses a webhook may have: none inside the network that the service stands in, else whoever may make a
//! webhook could make the service talk to what only it can reach.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

use url::{Host, Url};

/// More than any server takes in a request's first line.
pub const MOST_URL_BYTES: usize = 2048;

/// Why a text is no address that a webhook may have.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum AddressError {
    #[error("the URL has {0} bytes, more than {MOST_URL_BYTES}")]
    TooLong(usize),
    #[error("{0:?} is no URL")]
    NoUrl(String),
    #[error("the URL's scheme is {0:?}, not https")]
    Scheme(String),
    #[error("the URL holds a user name or a password")]
    Credentials,
    #[error("{0} is not a public address")]
    Private(IpAddr),
}

/// Checks what can be said without asking the name service; the rest is checked when the message is sent, on the very
/// address that is connected to. `private` allows plain HTTP and addresses of one's own network.
pub fn check_url(text: &str, private: bool) -> Result<Url, AddressError> {
    if text.len() > MOST_URL_BYTES {
        return Err(AddressError::TooLong(text.len()));
    }
    let url = Url::parse(text).map_err(|_| AddressError::NoUrl(text.into()))?;
    if url.scheme() != "https" && !(private && url.scheme() == "http") {
        return Err(AddressError::Scheme(url.scheme().into()));
    }
    if !url.username().is_empty() || url.password().is_some() {
        return Err(AddressError::Credentials);
    }
    let literal = match url.host() {
        None => return Err(AddressError::NoUrl(text.into())),
        Some(Host::Domain(_)) => None,
        Some(Host::Ipv4(address)) => Some(IpAddr::V4(address)),
        Some(Host::Ipv6(address)) => Some(IpAddr::V6(address)),
    };
    match literal.filter(|address| !private && !is_public(*address)) {
        Some(address) => Err(AddressError::Private(address)),
        None => Ok(url),
    }
}

/// Whether an address is on the public internet (IANA's special-purpose registries, RFC 6890).
pub fn is_public(address: IpAddr) -> bool {
    match address {
        IpAddr::V4(address) => is_public_v4(address),
        IpAddr::V6(address) => is_public_v6(address),
    }
}

fn is_public_v4(address: Ipv4Addr) -> bool {
    let [a, b, c, _] = address.octets();
    let special = address.is_private()
        || address.is_loopback()
        || address.is_link_local()
        || address.is_documentation()
        || address.is_multicast()
        // "This network", carriers' shared space, protocol assignments and the old 6to4 relays, benchmarks, reserved.
        || a == 0
        || (a == 100 && (64..128).contains(&b))
        || (a == 192 && b == 0 && c == 0)
        || (a == 192 && b == 88 && c == 99)
        || (a == 198 && (b == 18 || b == 19))
        || a >= 240;
    !special
}

fn is_public_v6(address: Ipv6Addr) -> bool {
    let segments = address.segments();
    // Addresses that carry a v4 address lead to it: mapped, compatible, NAT64, 6to4.
    let [.., g, h] = segments;
    let v4 = |high: u16, low: u16| Ipv4Addr::from(u32::from(high) << 16 | u32::from(low));
    match segments {
        [0, 0, 0, 0, 0, 0xffff | 0, ..] | [0x64, 0xff9b, 0, 0, 0, 0, ..] => return is_public_v4(v4(g, h)),
        [0x2002, high, low, ..] => return is_public_v4(v4(high, low)),
        _ => {}
    }
    // Global unicast is 2000::/3. Of it: protocol assignments with Teredo (2001::/23), documentation.
    let documentation =
        (segments[0] == 0x2001 && segments[1] == 0xdb8) || (segments[0] == 0x3fff && segments[1] < 0x1000);
    let protocols = segments[0] == 0x2001 && segments[1] < 0x200;
    segments[0] & 0xe000 == 0x2000 && !documentation && !protocols
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_public_internet_is_public() {
        for text in [
            "0.0.0.0",
            "10.1.2.3",
            "100.64.0.1",
            "127.0.0.1",
            "169.254.169.254",
            "172.16.0.1",
            "172.31.255.255",
            "192.0.0.8",
            "192.0.2.1",
            "192.88.99.1",
            "192.168.1.1",
            "198.18.0.1",
            "198.19.9.9",
            "203.0.113.5",
            "224.0.0.1",
            "240.0.0.1",
            "255.255.255.255",
            "::",
            "::1",
            "::127.0.0.1",
            "::ffff:127.0.0.1",
            "::ffff:10.0.0.1",
            "64:ff9b::a00:1",
            "64:ff9b:1::1",
            "100::1",
            "2001::1",
            "2001:db8::1",
            "2002:7f00:1::",
            "2002:c0a8:101::",
            "3fff:1::1",
            "5f00::1",
            "fc00::1",
            "fd12::1",
            "fe80::1",
            "fec0::1",
            "ff02::1",
        ] {
            assert!(!is_public(text.parse().unwrap()), "{text}");
        }
        for text in [
            "1.1.1.1",
            "8.8.8.8",
            "100.63.0.1",
            "100.128.0.1",
            "172.32.0.1",
            "192.0.1.1",
            "198.20.0.1",
            "::ffff:8.8.8.8",
            "64:ff9b::808:808",
            "2002:808:808::1",
            "2606:4700::1111",
            "2a00:1450::1",
        ] {
            assert!(is_public(text.parse().unwrap()), "{text}");
        }
    }

    #[test]
    fn a_url_is_https_to_somewhere_public() {
        for text in ["https://hooks.example/a?b=c", "https://8.8.8.8:8443/", "https://[2606:4700::1111]/x"] {
            assert_eq!(check_url(text, false).map(String::from), Ok(text.into()));
        }
        let long = format!("https://hooks.example/{}", "x".repeat(2048));
        let private = |text: &str| AddressError::Private(text.parse().unwrap());
        for (text, error) in [
            (long.as_str(), AddressError::TooLong(2070)),
            ("hooks.example", AddressError::NoUrl("hooks.example".into())),
            ("http://hooks.example/", AddressError::Scheme("http".into())),
            ("file:///etc/passwd", AddressError::Scheme("file".into())),
            ("https://me@hooks.example/", AddressError::Credentials),
            ("https://127.0.0.1/", private("127.0.0.1")),
            // Other spellings of 127.0.0.1 and 169.254.169.254.
            ("https://2130706433/", private("127.0.0.1")),
            ("https://0x7f.1/", private("127.0.0.1")),
            ("https://0251.0376.0251.0376/", private("169.254.169.254")),
            ("https://[::ffff:10.0.0.1]/", private("::ffff:10.0.0.1")),
        ] {
            assert_eq!(check_url(text, false), Err(error), "{text}");
        }
        assert!(check_url("http://127.0.0.1:9/", true).is_ok());
        assert!(check_url("ftp://127.0.0.1:9/", true).is_err());
    }
}
