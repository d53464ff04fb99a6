//! API keys: who may do what, how much and how often. `migrations/0010_api_keys.sql` explains each field.

use std::collections::BTreeSet;

use base64::Engine;
use base64::prelude::BASE64_URL_SAFE_NO_PAD;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use uuid::Uuid;

use super::Timestamp;
use super::queue::QueueFuture;

/// What a key allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Scope {
    /// Look at one's own jobs and avatars, render and download them.
    Read,
    /// Upload, cancel, retry, delete.
    Write,
    /// Read `/metrics`.
    Metrics,
    /// All of it, on everybody's jobs.
    Admin,
}

impl Scope {
    pub const ALL: [Scope; 4] = [Scope::Read, Scope::Write, Scope::Metrics, Scope::Admin];

    pub fn name(self) -> &'static str {
        match self {
            Scope::Read => "read",
            Scope::Write => "write",
            Scope::Metrics => "metrics",
            Scope::Admin => "admin",
        }
    }

    pub fn from_name(name: &str) -> Option<Scope> {
        Scope::ALL.into_iter().find(|scope| scope.name() == name)
    }
}

/// Limits of a key; None is no limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Quota {
    pub max_queued: Option<u32>,
    pub max_running: Option<u32>,
    /// Inputs and results that are kept.
    pub max_bytes: Option<u64>,
    /// Requests a minute.
    pub per_minute: Option<u32>,
}

/// A key to be made.
#[derive(Clone, Debug)]
pub struct NewKey {
    pub name: String,
    pub scopes: BTreeSet<Scope>,
    pub quota: Quota,
    pub expires_at: Option<Timestamp>,
}

/// An API key as it is kept: all of it but its secret, of which the database has a hash.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Key {
    pub id: Uuid,
    pub name: String,
    pub scopes: BTreeSet<Scope>,
    pub quota: Quota,
    pub created_at: Timestamp,
    pub expires_at: Option<Timestamp>,
    pub revoked_at: Option<Timestamp>,
}

impl Key {
    pub fn is_admin(&self) -> bool {
        self.scopes.contains(&Scope::Admin)
    }

    pub fn may(&self, scope: Scope) -> bool {
        self.is_admin() || self.scopes.contains(&scope)
    }

    /// Whether it opens anything at this time.
    pub fn is_alive(&self, now: Timestamp) -> bool {
        self.revoked_at.is_none() && self.expires_at.is_none_or(|end| now < end)
    }
}

/// What a client shows: `effigy_` and 256 random bits in base64url.
#[derive(Clone)]
pub struct Token(String);

impl Token {
    /// From the operating system's randomness.
    pub fn new() -> Result<Token, getrandom::Error> {
        let mut bytes = [0; 32];
        getrandom::fill(&mut bytes)?;
        Ok(Token(format!("effigy_{}", BASE64_URL_SAFE_NO_PAD.encode(bytes))))
    }

    pub fn from_text(text: &str) -> Token {
        Token(text.into())
    }

    /// To be shown once.
    pub fn reveal(&self) -> &str {
        &self.0
    }

    pub fn sha256(&self) -> [u8; 32] {
        Sha256::digest(self.0.as_bytes()).into()
    }
}

/// The keys and secrets of a service.
pub trait Keys: Send + Sync + 'static {
    /// None where a living key has this name.
    fn create_key<'a>(&'a self, key: &'a NewKey, token: &'a Token) -> QueueFuture<'a, Option<Key>>;
    /// All of them, the oldest first.
    fn list_keys(&self) -> QueueFuture<'_, Vec<Key>>;
    /// Revokes the living key of this name or id; None where there is none.
    fn revoke_key<'a>(&'a self, name_or_id: &'a str) -> QueueFuture<'a, Option<Key>>;
    /// The living key of a token.
    fn key_of<'a>(&'a self, token: &'a Token) -> QueueFuture<'a, Option<Key>>;
    /// The living key of an id.
    fn living_key(&self, id: Uuid) -> QueueFuture<'_, Option<Key>>;
    fn any_living_key(&self) -> QueueFuture<'_, bool>;
    /// Whether there ever was a key, be it expired or revoked by now.
    fn any_key(&self) -> QueueFuture<'_, bool>;
    /// Whose a job is: None where there is no such job, Some(None) where it is nobody's.
    fn owner_of(&self, job: Uuid) -> QueueFuture<'_, Option<Option<Uuid>>>;
    /// Bytes of inputs and results that are kept for a key.
    fn kept_bytes(&self, key: Uuid) -> QueueFuture<'_, u64>;
    /// Jobs of a key that wait.
    fn queued_jobs(&self, key: Uuid) -> QueueFuture<'_, u64>;
    /// The secret of this purpose; `fresh` becomes it where there is none yet.
    fn secret<'a>(&'a self, name: &'a str, fresh: [u8; 32]) -> QueueFuture<'a, Vec<u8>>;
}
